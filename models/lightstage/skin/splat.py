"""Drawing of pores, spots and hairs, listed once for a subject, into any window.

A window draws the marks that touch it. Values are added as integers or combined by maximum, so neither the order of the
marks nor the other marks of a window change a single bit, on a GPU either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin.window import ChartWindow

Float = npt.NDArray[np.float64]

_QUANTUM = 2.0**-20
_CHUNK = 1 << 21


@dataclass(frozen=True)
class Marks:
    """Places on the chart, each with its own frame.

    Attributes:
        uv: (N, 2) float64 chart coordinates, v up.
        frame: (N, 3) float64 (p, q, r): a chart step (du, dv) is (p du + q dv, r dv) mm.
        reach_mm: (N,) float64 radius beyond which the mark is nothing.
        values: (N, K) float64 parameters for the function that draws.
    """

    uv: Float
    frame: Float
    reach_mm: Float
    values: Float

    def __len__(self) -> int:
        return len(self.uv)

    def pick(self, index: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> Marks:
        """Some of the marks."""
        return Marks(self.uv[index], self.frame[index], self.reach_mm[index], self.values[index])

    @classmethod
    def joined(cls, lists: list[Marks]) -> Marks:
        """One list of several with the same parameters."""
        return cls(*(np.concatenate([getattr(m, f) for m in lists]) for f in ("uv", "frame", "reach_mm", "values")))


@dataclass(frozen=True)
class Stamp:
    """Texels around some marks.

    Attributes:
        texel: (M,) int64 flat index into the window.
        a, b: (M,) float32 mm from the mark along +u and across it towards +v.
        values: K tensors (M,) float32, the parameters of the mark.
        size_mm: (M,) float32 size of a texel, the square root of its area.
    """

    texel: Tensor
    a: Tensor
    b: Tensor
    values: list[Tensor]
    size_mm: Tensor


def stamps(marks: Marks, window: ChartWindow, device: torch.device | str = "cpu") -> Iterator[Stamp]:
    """Texels within reach of each mark, in chunks of bounded size."""
    if not len(marks):
        return
    width, height = window.chart_width, window.chart_height
    x, y = marks.uv[:, 0] * width, (1.0 - marks.uv[:, 1]) * height
    p, q, r = marks.frame[:, 0] / width, marks.frame[:, 1] / height, marks.frame[:, 2] / height
    # A mark smaller than a texel still has to reach the texels around it.
    reach = marks.reach_mm + 1.5 * np.sqrt(p * r)
    half_y = np.ceil(reach / r).astype(np.int64) + 1
    half_x = np.ceil(reach * np.sqrt(1.0 + (q / r) ** 2) / p).astype(np.int64) + 1
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    touches = (column + half_x >= window.x) & (column - half_x < window.x + window.width)
    touches &= (row + half_y >= window.y) & (row - half_y < window.y + window.height)
    chosen = np.flatnonzero(touches)
    # Boxes are enlarged to a few sizes, so that equal boxes can be drawn together.
    box = np.maximum(half_x, half_y)[chosen]
    box = np.where(box <= 16, box, (2.0 ** (np.ceil(np.log2(np.maximum(box, 1)) * 2) / 2)).astype(np.int64) + 1)
    for half in np.unique(box):
        span = torch.arange(-int(half), int(half) + 1, device=device)
        group = chosen[box == half]
        per_chunk = max(1, _CHUNK // (len(span) ** 2))
        for start in range(0, len(group), per_chunk):
            index = group[start : start + per_chunk]
            yield _stamp(marks, reach, index, (x, y, column, row), (p, q, r), span, window, device)


def _stamp(
    marks: Marks,
    reach: Float,
    index: npt.NDArray[np.int64],
    place: tuple[Float, Float, npt.NDArray[np.int64], npt.NDArray[np.int64]],
    frame: tuple[Float, Float, Float],
    span: Tensor,
    window: ChartWindow,
    device: torch.device | str,
) -> Stamp:
    def single(values: npt.NDArray[np.generic]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device)

    x, y, column, row = (a[index] for a in place)
    c = single(column - window.x)[:, None] + span  # (n, k)
    r = single(row - window.y)[:, None] + span
    dx = (span + 0.5) - single((x - column).astype(np.float32))[:, None]
    dy = (span + 0.5) - single((y - row).astype(np.float32))[:, None]
    fp, fq, fr = (single(f[index].astype(np.float32))[:, None, None] for f in frame)
    up = -dy[:, :, None]
    a, b = fp * dx[:, None, :] + fq * up, fr * up + torch.zeros_like(dx)[:, None, :]
    inside = ((r >= 0) & (r < window.height))[:, :, None] & ((c >= 0) & (c < window.width))[:, None, :]
    inside = inside & (a * a + b * b <= single((reach[index] ** 2).astype(np.float32))[:, None, None])
    which = inside.nonzero()
    owner = which[:, 0]
    texel = r[owner, which[:, 1]] * window.width + c[owner, which[:, 2]]
    values = single(marks.values[index].astype(np.float32))
    size = single(np.sqrt(frame[0][index] * frame[2][index]).astype(np.float32))
    columns = [values[:, k][owner] for k in range(values.shape[1])]
    return Stamp(texel, a[inside], b[inside], columns, size[owner])


def add(total: Tensor, texel: Tensor, value: Tensor) -> None:
    """Add float values to an int32 accumulator (window texels,), in steps of 2^-20."""
    total.index_add_(0, texel, (value / _QUANTUM).round().int())


def raise_to(total: Tensor, texel: Tensor, value: Tensor) -> None:
    """Keep the largest value at each texel of a float32 accumulator (window texels,)."""
    total.scatter_reduce_(0, texel, value, "amax")


def accumulator(window: ChartWindow, device: torch.device | str = "cpu") -> Tensor:
    """An empty accumulator for ``add``."""
    return torch.zeros(window.width * window.height, dtype=torch.int32, device=device)


def peak(window: ChartWindow, device: torch.device | str = "cpu") -> Tensor:
    """An empty accumulator for ``raise_to``: values below 0 do not count."""
    return torch.zeros(window.width * window.height, device=device)


def finished(total: Tensor, window: ChartWindow) -> Tensor:
    """(h, w) float32 of an accumulator."""
    values = total.float() * _QUANTUM if total.dtype == torch.int32 else total
    return values.view(window.height, window.width)
