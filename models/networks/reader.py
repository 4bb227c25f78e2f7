"""The reader: what every pixel of a photo's crop shows of our head.

A U-shaped network over the whole crop. Into it goes an sRGB crop of 256 x 256, out of it come, for each cell of four by
four pixels, chart coordinates and a normal, each with its uncertainty, and for each cell of two by two the parts.
It always sees the whole crop, so it may normalise over it (group normalisation).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from models.networks.blocks import activation
from models.networks.context import NormBlock

SIDE = 256
"""Pixels along each side of the crop."""
CELL, PART_CELL = 4, 2
"""Pixels along each side of a cell of chart coordinates and normals, and of parts."""
PARTS = 13
"""Of ``service.face.reading.part_labels``."""
CHART_MM = (410.0, 273.0)
"""Millimetres of face that one unit of u and of v stands for, about (15 texels per mm of 6144 x 4096)."""
LEAST_MM, LEAST_SINE = 0.3, 0.02
"""Standard deviations that the network may claim at best: of a chart coordinate, and of a normal's component."""


@dataclass(frozen=True)
class ReaderSize:
    """Channels at 1/2, 1/4 ... of the crop, and residual blocks at each size on the way down and up."""

    widths: tuple[int, ...] = (16, 32, 64, 96, 128)
    down: tuple[int, ...] = (0, 1, 2, 3, 3)
    up: int = 1


READER_SIZES = {
    "slim": ReaderSize((16, 24, 40, 64, 88)),
    "compact": ReaderSize(),
    "broad": ReaderSize((16, 40, 80, 120, 160)),
}
"""Named sizes: 0.8, 1.6 (shipped) and 2.4 GFLOP a crop."""


@dataclass(frozen=True)
class Read:
    """What the network says of N crops.

    Attributes:
        chart: (N, 2, 64, 64) u and v of the middle of each cell; chart_mm: (N, 1, 64, 64) their standard deviation.
        normal: (N, 3, 64, 64) unit, camera space; normal_sine: (N, 1, 64, 64) standard deviation of its components.
        parts: (N, 13, 128, 128) logarithms of probabilities, up to a constant.
    """

    chart: Tensor
    chart_mm: Tensor
    normal: Tensor
    normal_sine: Tensor
    parts: Tensor


class Reader(nn.Module):
    """The network; ``forward`` gives plain tensors for the export, ``read`` the same by name."""

    def __init__(self, size: ReaderSize | None = None) -> None:
        super().__init__()
        self.size = size or ReaderSize()
        widths = self.size.widths
        self.stem = nn.Conv2d(3, widths[0], 5, stride=2, padding=2)
        self.act = activation()
        self.shrink = nn.ModuleList(nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in itertools.pairwise(widths))
        self.down = nn.ModuleList(_blocks(w, n) for w, n in zip(widths, self.size.down, strict=True))
        self.merge = nn.ModuleList(nn.Conv2d(a + b, b, 1) for a, b in zip(widths[:1:-1], widths[-2:0:-1], strict=True))
        self.up = nn.ModuleList(_blocks(w, self.size.up) for w in widths[-2:0:-1])
        self.last = nn.Sequential(NormBlock(widths[1]), nn.GroupNorm(widths[1] // 8, widths[1]), activation())
        self.fields = nn.Conv2d(widths[1], 7, 1)
        self.parts = nn.Sequential(nn.Conv2d(widths[1], 4 * PARTS, 1), nn.PixelShuffle(2))
        # Factors of the standard deviations, set when a run is exported.
        self.spread_scale: Tensor
        self.register_buffer("spread_scale", torch.ones(2), persistent=False)

    def features(self, crop: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3, S, S) sRGB in [0, 1] -> what is known of the whole, S / 32 cells a side, and of places, S / 4."""
        x = self.act(self.stem(2.0 * crop - 1.0))
        kept = []
        for i, blocks in enumerate(self.down):
            if i:
                x = self.shrink[i - 1](x)
            x = blocks(x)
            kept.append(x)
        deep = x
        for merge, blocks, beside in zip(self.merge, self.up, kept[-2:0:-1], strict=True):
            x = functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
            x = blocks(merge(torch.cat([x, beside], 1)))
        return deep, self.last(x)

    def forward(self, crop: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """(N, 3, 256, 256) sRGB in [0, 1] -> the fields of ``Read`` in their order."""
        _, x = self.features(crop)
        f = self.fields(x).float()
        normal = f[:, 3:6] / (f[:, 3:6].square().sum(1, keepdim=True) + 1e-8).sqrt()
        spread_mm = LEAST_MM + functional.softplus(f[:, 2:3] + 3.0)
        spread = LEAST_SINE + functional.softplus(f[:, 6:7] - 1.5)
        scale = self.spread_scale
        return f[:, :2] + 0.5, scale[0] * spread_mm, normal, scale[1] * spread, self.parts(x).float()

    def read(self, crop: Tensor) -> Read:
        """``forward`` by name."""
        return Read(*self(crop))


def _blocks(width: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(NormBlock(width) for _ in range(count)))


def flops(network: Reader, side: int = SIDE) -> float:
    """Floating-point operations of the convolutions for one crop; a multiplication with its addition counts two."""
    total = 0.0

    def count(module: nn.Module, _: tuple[Tensor, ...], out: Tensor) -> None:
        nonlocal total
        conv = cast(nn.Conv2d, module)
        total += 2.0 * out.numel() * conv.in_channels / conv.groups * conv.kernel_size[0] * conv.kernel_size[1]

    hooks = [m.register_forward_hook(count) for m in network.modules() if isinstance(m, nn.Conv2d)]
    with torch.no_grad():
        network(torch.zeros(1, 3, side, side))
    for hook in hooks:
        hook.remove()
    return total
