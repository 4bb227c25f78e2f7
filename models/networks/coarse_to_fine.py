"""The paper's own generator: pix2pixHD's coarse-to-fine translator (Wang et al. 2018), 9 global and 3 local blocks.

Its instance normalisation is replaced by a norm over the channels of each pixel, so that tiles equal the whole; its
transposed convolutions by nearest neighbour and convolution, which leave no checkerboard in normals.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from models.networks.blocks import Up, initialise, inside, rounded_up


@dataclass(frozen=True)
class CoarseToFineSize:
    """Width of the first global layer, times the resolution is halved, residual blocks of both generators."""

    width: int = 64
    halvings: int = 4
    global_blocks: int = 9
    local_blocks: int = 3

    @property
    def stride(self) -> int:
        """Sides of the input have to be multiples of it."""
        return int(2 ** (self.halvings + 1))


class PixelNorm(nn.Module):
    """x / sqrt(mean of x^2 over channels), which needs no neighbour (Karras et al. 2018)."""

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> the same."""
        return x * torch.rsqrt(x.square().mean(1, keepdim=True) + 1e-8)


class NormResidual(nn.Module):
    """pix2pixHD's residual block with the norm above."""

    radius = 2

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1), PixelNorm(), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1), PixelNorm(),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> the same."""
        return cast(Tensor, x + 0.2 * self.body(x))


def _conv(width_in: int, width_out: int, kernel: int, stride: int = 1) -> nn.Sequential:
    conv = nn.Conv2d(width_in, width_out, kernel, stride=stride, padding=kernel // 2)
    return nn.Sequential(conv, PixelNorm(), nn.ReLU())


class CoarseToFine(nn.Module):
    """Global generator at half the resolution inside a local enhancer at the full one."""

    def __init__(self, channels: int, out: int, size: CoarseToFineSize) -> None:
        super().__init__()
        self.size = size
        width, local = size.width, size.width // 2
        widths = [width * 2**i for i in range(size.halvings + 1)]
        down = [_conv(a, b, 3, 2) for a, b in itertools.pairwise(widths)]
        up = [nn.Sequential(Up(b, a), PixelNorm(), nn.ReLU()) for a, b in itertools.pairwise(widths)]
        blocks = [NormResidual(widths[-1]) for _ in range(size.global_blocks)]
        self.coarse = nn.Sequential(_conv(channels, width, 7), *down, *blocks, *reversed(up))
        self.enter = nn.Sequential(_conv(channels, local, 7), _conv(local, width, 3, 2))
        self.fine = nn.Sequential(
            *(NormResidual(width) for _ in range(size.local_blocks)), Up(width, local), PixelNorm(), nn.ReLU()
        )
        initialise(self)
        self.head = nn.Conv2d(local, out, 7, padding=3)
        nn.init.normal_(self.head.weight, std=0.02)

    def forward(self, x: Tensor, margin: int = 0) -> Tensor:
        """(N, channels, H, W) -> (N, out, H, W) without ``margin`` pixels at each side; H and W multiples of
        ``size.stride``.
        """
        coarse = self.coarse(nn.functional.avg_pool2d(x, 2))
        return inside(self.head(self.fine(self.enter(x) + coarse)), margin)

    def halo(self) -> int:
        """Input pixels beyond which nothing matters, rounded up to the stride."""
        reach, cell = 3.0 + 3.0 * 2, 2  # 7 x 7 head; 7 x 7 stem of the global generator at half the resolution
        reach += self.size.local_blocks * NormResidual.radius * 2 + 2
        for _ in range(self.size.halvings):
            reach += cell + cell  # strided 3 x 3 kernel, and 3 x 3 after enlarging back to this cell
            cell *= 2
        reach += self.size.global_blocks * NormResidual.radius * cell
        return rounded_up(reach + cell, self.size.stride)
