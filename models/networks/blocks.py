"""Parts that the networks share. None of them looks further than its kernel, so any tiling equals the whole."""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn

SLOPE = 0.2
RESIDUAL = 0.2


def activation() -> nn.Module:
    """Leaky ReLU, as in the discriminators of pix2pixHD."""
    return nn.LeakyReLU(SLOPE)


class Residual(nn.Module):
    """x + 0.2 conv(act(conv(x))); no normalisation, whose statistics would depend on the tile (Lim et al. 2017)."""

    radius = 2

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.act = activation()
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """(1, C, h, w) -> the same."""
        return cast(Tensor, x + RESIDUAL * self.second(self.act(self.first(x))))


class Up(nn.Module):
    """Twice the size by nearest neighbour and a 3 x 3 convolution, which gives no checkerboard."""

    def __init__(self, width_in: int, width_out: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(width_in, width_out, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """(1, C, h, w) -> (1, C', 2h, 2w)."""
        return cast(Tensor, self.conv(nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")))


def shuffle_head(width: int, channels: int, factor: int = 2, gain: float = 0.1) -> nn.Sequential:
    """3 x 3 convolution and pixel shuffle, begun as nearest neighbour (ICNR, Aitken et al. 2017)."""
    conv = nn.Conv2d(width, channels * factor**2, 3, padding=1)
    kernel = torch.empty(channels, *conv.weight.shape[1:])
    nn.init.kaiming_normal_(kernel, a=SLOPE)
    with torch.no_grad():
        conv.weight.copy_(kernel.repeat_interleave(factor**2, 0) * gain)
        nn.init.zeros_(cast(Tensor, conv.bias))
    return nn.Sequential(conv, nn.PixelShuffle(factor))


def initialise(module: nn.Module) -> None:
    """He's initialisation for leaky ReLU, small in the second convolution of residual blocks."""
    for part in module.modules():
        if isinstance(part, nn.Conv2d):
            nn.init.kaiming_normal_(part.weight, a=SLOPE)
            if part.bias is not None:
                nn.init.zeros_(part.bias)
    for part in module.modules():
        if isinstance(part, Residual):
            with torch.no_grad():
                part.second.weight.mul_(0.5)


def inside(x: Tensor, margin: int) -> Tensor:
    """(..., h, w) without ``margin`` cells at each side."""
    return x[..., margin:-margin, margin:-margin] if margin else x


def rounded_up(value: float, multiple: int) -> int:
    """The next multiple that is not smaller."""
    return math.ceil(value / multiple) * multiple
