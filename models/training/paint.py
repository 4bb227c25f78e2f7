"""Marks of the skin that no light made: brows, lips, beards and lids of every depth, tones of regions, blotches.

The light stage draws all of them, but at fixed places of the chart and within what its subjects have. A network that
knows by heart how dark a brow is takes the rest of a darker one for shade, and bleaches it. Painted on texture and
albedo alike, marks leave the light as it is: so the network has to tell them from shade.

The stage's regions are also more alike than those of real skin: its lids are as bright as its cheeks, in published
albedo maps they are a quarter to a half darker; cheeks and forehead are paler than the rest, temples and the sides of
the face darker, lips half as bright. What a network expects of a region is what it gives where shade and pigment cannot
be told apart, so the marks have about the mean of real skin, and a spread that is wider. Make-up is such a mark too.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from models.colour import linear, srgb
from models.training.degrade import blur, smooth_field
from models.training.pigment import Pigment
from models.training.regions import region_planes
from models.training.tasks import choice


@dataclass(frozen=True)
class Mark:
    """A mark on a region of the left half of the face, and its mirror image.

    Attributes:
        regions: of the head model, taken together.
        depth: range of -log(albedo with / without it) at its darkest; below 0 it is paler than the skin.
        colour: of that, by channel.
        shift: standard deviation of its place, texels of the context's chart: people and fits differ.
        patchy: standard deviation of its depth within the mark, as a share.
        soft: standard deviation of the blur of its borders, texels of the context's chart.
        often: share of the charts that have it.
        hues: standard deviation of the logarithm of its colour, by channel.
        beyond: it lies further from the chart's middle than this share of its width, softly.
    """

    regions: tuple[str, ...]
    depth: tuple[float, float]
    colour: tuple[float, float, float]
    shift: float
    patchy: float
    soft: float = 0.0
    often: float = 0.75
    hues: float = 0.1
    beyond: float = 0.0


MARKS = (
    Mark(("brow_left",), (-0.3, 1.4), (0.95, 1.0, 1.05), 2.0, 0.3),
    Mark(("lips",), (-0.1, 1.5), (0.65, 1.0, 0.95), 0.7, 0.1),
    Mark(("beard",), (-0.5, 0.9), (0.95, 1.0, 0.95), 2.0, 0.12),
    Mark(("eyelid_upper_left",), (-0.2, 0.8), (0.8, 1.0, 1.1), 1.0, 0.2),
    Mark(("eyelid_lower_left",), (-0.2, 0.7), (0.8, 1.0, 1.1), 1.0, 0.2),
    Mark(("eyelid_left",), (-0.2, 0.8), (0.8, 1.0, 1.1), 2.0, 0.2, 4.0),
    Mark(("cheek_left",), (-0.75, 0.1), (0.75, 1.0, 1.1), 3.0, 0.2, 4.0),
    Mark(("forehead",), (-0.6, 0.15), (0.8, 1.0, 1.05), 3.0, 0.2, 4.0),
    Mark(("nose",), (-0.25, 0.35), (0.9, 1.0, 1.0), 1.0, 0.2, 2.0),
    Mark(("nose_tip",), (-0.15, 0.6), (0.8, 1.0, 0.9), 1.5, 0.2, 2.0),
    Mark(("chin",), (-0.2, 0.6), (1.0, 0.95, 0.95), 3.0, 0.2, 4.0),
    Mark(("face",), (-0.15, 0.45), (0.9, 1.0, 1.0), 3.0, 0.2, 4.0, beyond=0.17),
    Mark(("ear_left",), (-0.2, 0.5), (0.5, 1.0, 0.9), 1.0, 0.2, 2.0),
    Mark(("neck",), (-0.05, 0.55), (0.9, 1.0, 1.0), 3.0, 0.2, 4.0),
    # Make-up: shadow and liner of eyes, blush, and foundation, which ends at the jaw.
    Mark(("eyelid_upper_left",), (0.2, 1.4), (1.0, 1.0, 1.0), 1.0, 0.1, 1.5, often=0.12, hues=0.3),
    Mark(("cheek_left",), (0.05, 0.5), (0.15, 1.0, 0.7), 4.0, 0.1, 4.0, often=0.12),
    Mark(("face",), (-0.4, 0.3), (0.9, 1.0, 1.1), 1.0, 0.05, 2.0, often=0.12, hues=0.2),
)
BEYOND_SOFT = 0.04
"""Share of the chart's width over which a mark begins that lies to the sides."""
BLOTCHES, BLOTCH_CELLS = 0.06, (6, 12, 24, 48)
"""Standard deviation of the logarithm of blotches, itself random, and how many of them lie across a chart."""


class Painter:
    """Paints charts; knows where the marks are."""

    def __init__(self, marks: tuple[Mark, ...] = MARKS) -> None:
        self.marks = marks
        sharp = region_planes(*(mark.regions for mark in marks))
        away = torch.linspace(-0.5, 0.5, sharp.shape[2]).abs()
        sides = [((away - m.beyond) / BEYOND_SOFT + 0.5).clamp(0.0, 1.0) if m.beyond else 1.0 for m in marks]
        soft = torch.cat(
            [blur((p * s).view(1, 1, *p.shape), m.soft)[0] for p, s, m in zip(sharp, sides, marks, strict=True)]
        )
        self.pigment = Pigment()
        self.places = soft / soft.amax((1, 2), keepdim=True).clamp(min=1e-6)
        self.shift = torch.tensor([[2.0 * m.shift / n for n in (sharp.shape[2], sharp.shape[1])] for m in marks])
        self.least, self.most = (torch.tensor([m.depth[end] for m in marks]) for end in (0, 1))
        self.often, self.patchy, self.hues = (
            torch.tensor([getattr(m, name) for m in marks]) for name in ("often", "patchy", "hues")
        )
        self.colour = torch.tensor([m.colour for m in marks])

    def __call__(self, texture: Tensor, albedo: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Both (N, 3, h, w), sRGB-coded in [0, 1], with the same marks; the light between them stays as it was."""
        density = self.density(len(texture), generator) + self.pigment.density(len(texture), generator)
        # What is bright already has no room for paler marks; the light would change where one of both is cut off.
        most = torch.maximum(linear(texture), linear(albedo)).clamp(min=1e-4)
        factor = torch.minimum(torch.exp(-density), 1.0 / most)
        return srgb(linear(texture) * factor), srgb(linear(albedo) * factor)

    def density(self, count: int, generator: torch.Generator) -> Tensor:
        """(N, 3, h, w) -log of what the marks leave of the albedo."""
        height, width = self.places.shape[1:]
        marks = len(self.marks)
        shift = self.shift * torch.randn(count, marks, 2, generator=generator)
        size = torch.exp(0.1 * torch.randn(count, marks, 2, generator=generator))
        where = moved(self.places.expand(count, -1, -1, -1), shift, size)
        amount = self.least + (self.most - self.least) * torch.rand(count, marks, generator=generator)
        amount = amount * (torch.rand(count, marks, generator=generator) < self.often)
        uneven = smooth_field((count, marks, height, width), 40, generator)
        patches = (1.0 + self.patchy[:, None, None] * uneven).clamp(min=0.0)
        hues = torch.exp(self.hues[:, None] * torch.randn(count, marks, 3, generator=generator))
        colour = amount[..., None] * self.colour * hues
        logs = torch.einsum("nmhw,nmc->nchw", torch.maximum(where, where.flip(-1)) * patches, colour)
        cells = BLOTCH_CELLS[choice(generator, len(BLOTCH_CELLS))]
        depth = BLOTCHES * torch.randn(count, 1, 1, 1, generator=generator)
        tint = 1.0 + 0.4 * torch.randn(count, 3, 1, 1, generator=generator)
        return logs + depth * tint * smooth_field((count, 1, height, width), cells, generator)


def moved(image: Tensor, shift: Tensor, size: Tensor) -> Tensor:
    """(N, M, h, w) moved by (N, M, 2), halves of the chart, and enlarged likewise about the first's middle."""
    n, marks, height, width = image.shape
    total = image[0].sum((1, 2)).clamp(min=1e-6)
    axes = (torch.linspace(-1.0, 1.0, length) for length in (width, height))
    middle = torch.stack(
        [(image[0].sum(dim) * axis).sum(1) / total for dim, axis in zip((1, 2), axes, strict=True)], 1
    )
    zoom = torch.diag_embed(1.0 / size)
    offset = middle - (zoom @ (middle + shift)[..., None])[..., 0]
    turn = torch.cat([zoom, offset[..., None]], 3).view(n * marks, 2, 3)
    grid = functional.affine_grid(turn, [n * marks, 1, height, width], align_corners=False)
    each = image.reshape(n * marks, 1, height, width)
    return functional.grid_sample(each, grid, align_corners=False).view(n, marks, height, width)
