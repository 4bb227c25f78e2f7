"""The translators' body: a U-shaped network whose output at a pixel depends on a bounded neighbourhood alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from models.networks.blocks import Residual, Up, activation, initialise, inside, rounded_up, shuffle_head


@dataclass(frozen=True)
class TranslatorSize:
    """Widths and numbers of residual blocks at 1/2, 1/4, 1/8, ... of the resolution, at each side of the U."""

    widths: tuple[int, ...]
    blocks: tuple[int, ...]

    @property
    def stride(self) -> int:
        """Sides of the input have to be multiples of it."""
        return int(2 ** len(self.widths))


class Stem(nn.Conv2d):
    """Detail channels and slow channels -> features at half the size.

    The detail channels enter by pixel unshuffle, so that none of their texels is lost; the slow ones (geometry,
    context) by their mean over 2 x 2 texels, which is all there is in them. Both and the 3 x 3 convolution behind them
    are linear, so they run as one 6 x 6 convolution of stride 2: runtimes pass over the full-size planes once. Four
    slow channels at a time come ``packed`` into one, at half their size; the first ``whole`` do not.
    """

    def __init__(self, detail: int, slow: int, width: int, whole: int = 0) -> None:
        super().__init__(4 * detail + slow, width, 3, padding=1)
        self.detail, self.slow, self.whole = detail, slow, whole

    def packed(self, x: Tensor) -> Tensor:
        """(N, detail + slow, H, W) -> (N, detail + whole + (slow - whole) / 4, H, W), rounded up."""
        kept, rest = x[:, : self.detail + self.whole], x[:, self.detail + self.whole :]
        small = nn.functional.avg_pool2d(rest, 2)
        missing = small.new_zeros(len(small), -rest.shape[1] % 4, *small.shape[2:])
        return torch.cat([kept, nn.functional.pixel_shuffle(torch.cat([small, missing], 1), 2)], 1)

    def forward(self, x: Tensor) -> Tensor:
        """``packed`` channels -> (N, width, H / 2, W / 2)."""
        fast, whole, rest = self.weight.split([4 * self.detail, self.whole, self.slow - self.whole], 1)
        missing = rest.new_zeros(len(rest), -(self.slow - self.whole) % 4, 3, 3)
        parts = [nn.functional.pixel_shuffle(part, 2) for part in (fast, torch.cat([rest, missing], 1))]
        if self.whole:
            parts.insert(1, nn.functional.interpolate(whole, scale_factor=2.0, mode="nearest") * 0.25)
        kernel = torch.cat(parts, 1)
        return nn.functional.conv2d(x, kernel, self.bias, stride=2, padding=2)


class Translator(nn.Module):
    """Detail channels and slow channels -> output channels."""

    def __init__(self, detail: int, slow: int, out: int, size: TranslatorSize, whole: int = 0) -> None:
        super().__init__()
        widths, blocks = size.widths, size.blocks
        self.size = size
        self.stem = Stem(detail, slow, widths[0], whole)
        self.down = nn.ModuleList()
        self.before = nn.ModuleList()
        self.up = nn.ModuleList()
        self.merge = nn.ModuleList()
        self.after = nn.ModuleList()
        for i, width in enumerate(widths[:-1]):
            self.before.append(nn.Sequential(*(Residual(width) for _ in range(blocks[i]))))
            self.down.append(nn.Conv2d(width, widths[i + 1], 4, stride=2, padding=1))
            self.up.append(Up(widths[i + 1], width))
            self.merge.append(nn.Conv2d(2 * width, width, 1))
            self.after.append(nn.Sequential(*(Residual(width) for _ in range(blocks[i]))))
        self.bottom = nn.Sequential(*(Residual(widths[-1]) for _ in range(blocks[-1])))
        self.act = activation()
        initialise(self)
        self.head = shuffle_head(widths[0], out)

    def forward(self, x: Tensor, margin: int = 0) -> Tensor:
        """``packed`` channels -> (N, out, H, W) without ``margin`` pixels at each side; these, H and W are
        multiples of ``size.stride``.

        The way up sees no more beyond the result than it reaches itself: its largest planes are its last.
        """
        levels = len(self.size.widths)
        around = [margin // 2 ** (level + 1) for level in range(levels)]
        reach = self.reach() if margin else [0] * levels
        y = self.act(self.stem(x))
        kept = []
        for before, down in zip(self.before, self.down, strict=True):
            y = before(y)
            kept.append(y)
            y = self.act(down(y))
        y = inside(self.bottom(y), around[-1] - reach[-1])
        for i in reversed(range(len(kept))):
            wide = 2 * reach[i + 1]
            y = torch.cat([self.act(self.up[i](y)), inside(kept[i], around[i] - wide)], 1)
            y = inside(self.after[i](self.act(self.merge[i](y))), wide - reach[i])
        last, shuffle = self.head
        # One cell less at each side than without a margin: what lies beyond is not computed, and nothing is cut off.
        return cast(Tensor, shuffle(nn.functional.conv2d(y, last.weight, last.bias, padding=1 - reach[0])))

    def reach(self) -> list[int]:
        """Cells beyond the result, at 1/2, 1/4, 1/8, ... of the resolution, that the way up from there looks at."""
        found = [1]
        for count in self.size.blocks[:-1]:
            found.append(math.ceil((found[-1] + count * Residual.radius + 1) / 2))
        return found

    def halo(self) -> int:
        """Input pixels beyond which nothing matters, rounded up to the stride.

        Kernels add their radius times the size of a cell: stem and head 1 cell of 2 pixels each; at each level the
        residual blocks of both sides, the strided 4 x 4 kernel (2 fine cells) and the convolution after enlarging.
        """
        reach, cell = 2.0 * 2, 2
        levels = len(self.size.widths)
        for level, count in enumerate(self.size.blocks):
            sides = 1 if level == levels - 1 else 2
            reach += sides * count * Residual.radius * cell
            if level < levels - 1:
                reach += 2 * cell + 1 * cell
                cell *= 2
        # A window may begin anywhere in the coarsest cell.
        return rounded_up(reach + cell, self.size.stride)
