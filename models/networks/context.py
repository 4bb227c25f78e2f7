"""The whole-chart network of delta: what light does to the face, at 288 x 192.

A tile cannot know where the light comes from. This network sees the whole chart once, at a small size, and hands the
logarithm of the baked light to every tile. It always runs on the whole, so it may normalise over it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from models.colour import linear
from models.networks.blocks import activation

WIDTH, HEIGHT = 288, 192
DARKEST = 1.0 / 255.0 / 12.92
"""Linear value of the darkest code but black; logarithms stop here."""


@dataclass(frozen=True)
class ContextSize:
    """Widths and numbers of blocks at full, 1/2, 1/4, ... of the size; sides are multiples of 2 ** (levels - 1)."""

    widths: tuple[int, ...]
    blocks: tuple[int, ...]


class NormBlock(nn.Module):
    """Residual block with group normalisation over the whole chart."""

    def __init__(self, width: int) -> None:
        super().__init__()
        groups = max(width // 8, 1)
        self.body = nn.Sequential(
            nn.GroupNorm(groups, width), activation(), nn.Conv2d(width, width, 3, padding=1),
            nn.GroupNorm(groups, width), activation(), nn.Conv2d(width, width, 3, padding=1),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> the same."""
        return cast(Tensor, x + self.body(x))


class ContextNet(nn.Module):
    """Texture (sRGB-coded, [-1, 1]) and geometry -> log of (texture / diffuse albedo) per channel, linear values."""

    def __init__(self, channels: int, size: ContextSize) -> None:
        super().__init__()
        widths = size.widths
        self.stem = nn.Conv2d(channels + 3, widths[0], 3, padding=1)
        pairs = list(zip(widths, size.blocks, strict=True))
        self.before = nn.ModuleList(self._blocks(w, n) for w, n in pairs[:-1])
        self.down = nn.ModuleList(nn.Conv2d(a, b, 4, stride=2, padding=1) for a, b in itertools.pairwise(widths))
        self.bottom = self._blocks(*pairs[-1])
        self.up = nn.ModuleList(nn.Conv2d(b, a, 3, padding=1) for a, b in itertools.pairwise(widths))
        self.merge = nn.ModuleList(nn.Conv2d(2 * w, w, 1) for w in widths[:-1])
        self.after = nn.ModuleList(self._blocks(w, n) for w, n in pairs[:-1])
        self.act = activation()
        self.head = nn.Conv2d(widths[0], 3, 3, padding=1)
        nn.init.normal_(self.head.weight, std=0.01)
        nn.init.zeros_(cast(Tensor, self.head.bias))

    @staticmethod
    def _blocks(width: int, count: int) -> nn.Sequential:
        return nn.Sequential(*(NormBlock(width) for _ in range(count)))

    def forward(self, x: Tensor) -> Tensor:
        """(N, 3 + geometry, 192, 288) -> (N, 3, 192, 288)."""
        logs = torch.log(linear(x[:, :3] * 0.5 + 0.5).clamp(min=DARKEST)) * 0.25 + 0.5
        y = self.stem(torch.cat([x, logs], 1))
        kept = []
        for before, down in zip(self.before, self.down, strict=True):
            y = before(y)
            kept.append(y)
            y = down(y)
        y = self.bottom(y)
        for i in reversed(range(len(kept))):
            y = self.up[i](nn.functional.interpolate(y, scale_factor=2.0, mode="nearest"))
            y = self.after[i](self.merge[i](torch.cat([y, kept[i]], 1)))
        return cast(Tensor, self.head(self.act(y)))
