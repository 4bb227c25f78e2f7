"""zeta, the super-resolution network: RCAN (Zhang et al. 2018), cut into a body for the whole map and a tail for tiles.

Channel attention averages over the whole image, so the body runs once on the whole texture (AvatarMe's 576 x 384 fits
easily); the tail looks two pixels far and runs in tiles. Any tiling then equals the whole. What the tail finds is
added to a smooth enlargement; it gets seeded noise to make pores of, since a pixel of the texture covers dozens.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from models.networks.blocks import activation, initialise, inside, shuffle_head

SCALE = 8


@dataclass(frozen=True)
class RcanSize:
    """Residual groups, blocks in each, features, reduction of channel attention, widths of the tail at x2 and x4."""

    groups: int
    blocks: int
    features: int
    reduction: int = 16
    tail: tuple[int, int] = (64, 64)
    noise: int = 0


class ChannelAttention(nn.Module):
    """Features scaled by a function of their means over the image (RCAN, eq. 9)."""

    def __init__(self, features: int, reduction: int) -> None:
        super().__init__()
        squeezed = max(features // reduction, 2)
        self.squeeze = nn.Conv2d(features, squeezed, 1)
        self.excite = nn.Conv2d(squeezed, features, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> the same."""
        mean = x.mean((2, 3), keepdim=True)
        return cast(Tensor, x * torch.sigmoid(self.excite(torch.relu(self.squeeze(mean)))))


class AttentionBlock(nn.Module):
    """Residual channel attention block (RCAN, eq. 10)."""

    def __init__(self, features: int, reduction: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(features, features, 3, padding=1)
        self.second = nn.Conv2d(features, features, 3, padding=1)
        self.attention = ChannelAttention(features, reduction)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> the same."""
        return cast(Tensor, x + self.attention(self.second(torch.relu(self.first(x)))))


class RcanBody(nn.Module):
    """Texture and slow channels -> features at the same size; residual in residual (RCAN, eq. 4 to 6)."""

    def __init__(self, channels: int, size: RcanSize) -> None:
        super().__init__()
        self.stem = nn.Conv2d(channels, size.features, 3, padding=1)
        self.groups = nn.ModuleList()
        for _ in range(size.groups):
            blocks = [AttentionBlock(size.features, size.reduction) for _ in range(size.blocks)]
            self.groups.append(nn.Sequential(*blocks, nn.Conv2d(size.features, size.features, 3, padding=1)))
        self.end = nn.Conv2d(size.features, size.features, 3, padding=1)
        initialise(self)
        for module in self.modules():
            if isinstance(module, AttentionBlock):
                nn.init.normal_(module.second.weight, std=0.01)
        for group in self.groups:
            nn.init.normal_(cast(nn.Conv2d, cast(nn.Sequential, group)[-1]).weight, std=0.01)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> (N, features, h, w)."""
        first = y = self.stem(x)
        for group in self.groups:
            y = y + group(y)
        return cast(Tensor, first + self.end(y))


def with_detail(texture: Tensor, detail: Tensor) -> Tensor:
    """(N, 3, 8h, 8w) in [-1, 1]: a texture (N, 3, h, w) enlarged smoothly, and the tail's detail.

    Not bilinearly: its kinks along the cells of the texture are faint in colour, but a grid in relief read off it.
    """
    base = nn.functional.interpolate(texture, scale_factor=float(SCALE), mode="bicubic", align_corners=False)
    return (base + detail).clamp(-1.0, 1.0)


class RcanTail(nn.Module):
    """Features and noise at the small size -> detail of the texture at eight times the size.

    Attributes:
        margin: small pixels at each side that the result is without: 0 where it is trained.
    """

    halo = 2
    """Small pixels: convolutions 1 + 1/2 + 1/4 + 1/4."""
    margin = 0

    def __init__(self, size: RcanSize) -> None:
        super().__init__()
        first, second = size.tail
        self.features, self.noise = size.features, size.noise
        initialise(self)
        self.twice = shuffle_head(size.features + size.noise, first, gain=1.0)
        self.four = shuffle_head(first, second, gain=1.0)
        self.refine = nn.Conv2d(second, second, 3, padding=1)
        self.act = activation()
        self.eight = shuffle_head(second, 3, gain=0.1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, features + noise, h, w) -> (N, 3, 8h, 8w)."""
        y = self.act(self.twice(x))
        y = self.act(self.four(y))
        y = self.act(self.refine(y))
        last, shuffle = self.eight
        spare = 1 if self.margin else 0  # cells beyond the result that the last convolution reads
        y = inside(y, self.margin * SCALE // 2 - spare)
        return cast(Tensor, shuffle(nn.functional.conv2d(y, last.weight, last.bias, padding=1 - spare)))
