"""The whole-chart network of delta: what light does to the face, at 288 x 192.

A tile cannot know where the light comes from. This network sees the whole chart once, at a small size, and hands the
logarithm of the baked light to every tile. It always runs on the whole, so it may normalise over it.

Nobody can tell a dark face in bright light from a fair one in dim light by skin alone. So the network works on the
texture relative to its own mean, and is told the light that the whites of the eyes show. Where none is seen, it is told
how brightly the photo shows the face: photos are exposed for what is in the light of the face, and whatever is white
there is seldom far beyond what a sensor can show.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from models.colour import linear, srgb
from models.networks.blocks import activation

WIDTH, HEIGHT = 288, 192
DARKEST = 1.0 / 255.0 / 12.92
"""Linear value of the darkest code but black; logarithms stop here."""

USUAL = 0.16
"""Mean albedo of skin from which the network starts, and to which the texture is brought before it is looked at."""

CLIPPED = 0.97
"""Code from which light may be lost to overexposure."""

SURE = 0.7
"""Share of lit skin from which a texel is looked at: at a hairline the others have the colour of hair."""

HALVINGS, NEAR = 4, 0.02
"""How often the chart is halved to fill what is no lit skin, and the share of lit skin that half settles a texel."""


@dataclass(frozen=True)
class ContextSize:
    """Widths and numbers of blocks at 1/2, 1/4, ... of the size; sides are multiples of 2 ** levels."""

    widths: tuple[int, ...]
    blocks: tuple[int, ...]


def filled(values: Tensor, lit: Tensor) -> Tensor:
    """(N, C, h, w) values where lit, (N, 1, h, w) in [0, 1], and smoothly continued from there to all else.

    Pull and push: means of lit texels at ever coarser sizes, each filled from the next. What the values are where
    nothing is lit does not matter at all. 0 where no texel of a chart is lit. Sides are multiples of 2 ** HALVINGS.
    """
    sums, weights = [values * lit], [lit]
    for _ in range(HALVINGS):
        sums.append(nn.functional.avg_pool2d(sums[-1], 2))
        weights.append(nn.functional.avg_pool2d(weights[-1], 2))
    wide = {"kernel_size": 5, "stride": 1, "padding": 2}
    total = sums[-1].sum((2, 3), keepdim=True) / (weights[-1].sum((2, 3), keepdim=True) + 1e-6)
    result = _settled(nn.functional.avg_pool2d(sums[-1], **wide), nn.functional.avg_pool2d(weights[-1], **wide), total)
    for number, (part, weight) in enumerate(zip(reversed(sums), reversed(weights), strict=True)):
        if number:
            result = nn.functional.interpolate(result, scale_factor=2.0, mode="bilinear", align_corners=False)
        result = _settled(part, weight, result)
    return lit * values + (1.0 - lit) * result


def _settled(part: Tensor, weight: Tensor, coarser: Tensor) -> Tensor:
    return (part + NEAR * coarser) / (weight + NEAR)


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
    """Texture (sRGB-coded, [-1, 1]), light of the eyes, geometry -> log of (texture / diffuse albedo), linear values.

    The last channel is the lit skin: of all else, hair or made-up colour, the texture is not looked at. A texture that
    is brighter by a factor gives, beside eyes that are as well, a light that is brighter by that factor, as long as
    nothing is clipped.
    """

    def __init__(self, channels: int, size: ContextSize) -> None:
        super().__init__()
        widths = size.widths
        # Colours twice, coded and as logarithms, where they are clipped, and the exposure.
        self.stem = nn.Conv2d(4 * (channels + 5), widths[0], 3, padding=1)
        pairs = list(zip(widths, size.blocks, strict=True))
        self.before = nn.ModuleList(self._blocks(w, n) for w, n in pairs[:-1])
        self.down = nn.ModuleList(nn.Conv2d(a, b, 4, stride=2, padding=1) for a, b in itertools.pairwise(widths))
        self.bottom = self._blocks(*pairs[-1])
        self.up = nn.ModuleList(nn.Conv2d(b, a, 3, padding=1) for a, b in itertools.pairwise(widths))
        self.merge = nn.ModuleList(nn.Conv2d(2 * w, w, 1) for w in widths[:-1])
        self.after = nn.ModuleList(self._blocks(w, n) for w, n in pairs[:-1])
        self.act = activation()
        self.head = nn.Conv2d(widths[0], 12, 3, padding=1)
        nn.init.normal_(self.head.weight, std=0.01)
        nn.init.zeros_(cast(Tensor, self.head.bias))

    @staticmethod
    def _blocks(width: int, count: int) -> nn.Sequential:
        return nn.Sequential(*(NormBlock(width) for _ in range(count)))

    def forward(self, x: Tensor) -> Tensor:
        """(N, 3 + 4 + geometry, 192, 288) -> (N, 3, 192, 288)."""
        logs = torch.log(linear(x[:, :3] * 0.5 + 0.5).clamp(min=DARKEST))
        lit = ((x[:, -1:] - SURE) / (1.0 - SURE)).clamp(0.0, 1.0)
        level = (logs.mean(1, keepdim=True) * lit).sum((2, 3), keepdim=True) / (lit.sum((2, 3), keepdim=True) + 1e-3)
        level = level - math.log(USUAL)
        light, known = x[:, 3:6], x[:, 6:7]
        colours = filled((logs - level).clamp(-6.0, 2.0), lit)
        clipped = lit * (x[:, :3].amax(1, keepdim=True) * 0.5 + 0.5 > CLIPPED).to(x.dtype)
        exposure = level.clamp(-6.0, 3.0) * (1.0 - known)
        told = [(light - level) * known, x[:, 6:], exposure]
        seen = [srgb(torch.exp(colours)) * 2.0 - 1.0, colours * 0.4 + 0.8, clipped, *told]
        y = self.stem(nn.functional.pixel_unshuffle(torch.cat(seen, 1), 2))
        kept = []
        for before, down in zip(self.before, self.down, strict=True):
            y = before(y)
            kept.append(y)
            y = down(y)
        y = self.bottom(y)
        for i in reversed(range(len(kept))):
            y = self.up[i](nn.functional.interpolate(y, scale_factor=2.0, mode="nearest"))
            y = self.after[i](self.merge[i](torch.cat([y, kept[i]], 1)))
        return cast(Tensor, nn.functional.pixel_shuffle(self.head(self.act(y)), 2) + level)
