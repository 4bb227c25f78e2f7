"""Reading maps of the whole chart at the texels of a window, and at points beside them."""

from __future__ import annotations

import torch
from torch import Tensor

from models.lightstage.skin.window import ChartWindow


def enlarged(image: Tensor, window: ChartWindow) -> Tensor:
    """(C, h, w) of a map (C, H, W) of the whole chart at the window's texels, bilinear; borders go on outside it."""
    result = image
    for axis, position in ((1, window.rows(image.shape[1])), (2, window.columns(image.shape[2]))):
        count = image.shape[axis]
        low = position.floor()
        share = (position - low).to(image.device, image.dtype).view((1, -1, 1) if axis == 1 else (1, 1, -1))
        index = low.long().to(image.device)
        first = result.index_select(axis, index.clamp(0, count - 1))
        second = result.index_select(axis, (index + 1).clamp(0, count - 1))
        result = first + (second - first) * share
    return result


def reduced(image: Tensor, height: int, width: int) -> Tensor:
    """(C, height, width) area means of (C, H, W)."""
    return torch.nn.functional.adaptive_avg_pool2d(image[None], (height, width))[0]


def displaced(image: Tensor, right: Tensor, up: Tensor) -> Tensor:
    """(h, w) of an image (h, w) read bilinearly ``right`` and ``up`` texels away from each texel; borders repeated."""
    height, width = image.shape
    column = (torch.arange(width, device=image.device) + right).clamp(0, width - 1)
    row = (torch.arange(height, device=image.device)[:, None] - up).clamp(0, height - 1)
    return read_at(image, row.expand(height, width), column.expand(height, width))


def read_at(image: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """Bilinear values of an image (h, w) at rows in [0, h - 1] and columns in [0, w - 1] of any one shape."""
    height, width = image.shape
    c0, r0 = column.floor(), row.floor()
    fc, fr = column - c0, row - r0
    c0, r0 = c0.long(), r0.long()
    c1, r1 = (c0 + 1).clamp(max=width - 1), (r0 + 1).clamp(max=height - 1)
    top = torch.lerp(image[r0, c0], image[r0, c1], fc.to(image.dtype))
    low = torch.lerp(image[r1, c0], image[r1, c1], fc.to(image.dtype))
    return torch.lerp(top, low, fr.to(image.dtype))


def unit(vectors: Tensor, fallback: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Tensor:
    """(3, ...) vectors of length 1; ``fallback`` where there is no direction."""
    length = vectors.square().sum(0).sqrt()
    up = torch.tensor(fallback, dtype=vectors.dtype, device=vectors.device).view(3, *[1] * (vectors.ndim - 1))
    return torch.where((length > 1e-6) & length.isfinite(), vectors / length.clamp(min=1e-6), up)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """(...) of (3, ...) and (3, ...)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
