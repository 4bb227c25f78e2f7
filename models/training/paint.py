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
from models.training.tasks import choice, uniform


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
        shape = (count, 1, height, width)
        logs = torch.zeros(count, 3, height, width)
        for place, mark in zip(self.places, self.marks, strict=True):
            shift = mark.shift * torch.randn(count, 2, generator=generator) * torch.tensor([2.0 / width, 2.0 / height])
            size = torch.exp(0.1 * torch.randn(count, 2, generator=generator))
            where = moved(place.expand(count, 1, -1, -1), shift, size)
            amount = uniform(generator, *mark.depth, count, 1, 1, 1)
            amount = amount * (torch.rand(count, 1, 1, 1, generator=generator) < mark.often)
            patches = (1.0 + mark.patchy * smooth_field(shape, 40, generator)).clamp(min=0.0)
            colour = torch.tensor(mark.colour) * torch.exp(mark.hues * torch.randn(count, 3, generator=generator))
            logs = logs + torch.maximum(where, where.flip(-1)) * amount * patches * colour[..., None, None]
        cells = BLOTCH_CELLS[choice(generator, len(BLOTCH_CELLS))]
        depth = BLOTCHES * torch.randn(count, 1, 1, 1, generator=generator)
        tint = 1.0 + 0.4 * torch.randn(count, 3, 1, 1, generator=generator)
        return logs + depth * tint * smooth_field(shape, cells, generator)


def moved(image: Tensor, shift: Tensor, size: Tensor) -> Tensor:
    """(N, 1, h, w) of which each is moved by (N, 2), halves of the chart, and enlarged by (N, 2) about its middle."""
    weight = image[:1].sum((0, 1))
    total = weight.sum().clamp(min=1e-6)
    axes = (torch.linspace(-1.0, 1.0, n) for n in (image.shape[3], image.shape[2]))
    middle = torch.stack([(weight.sum(dim) * axis).sum() / total for dim, axis in zip((0, 1), axes, strict=True)])
    zoom = torch.diag_embed(1.0 / size)
    offset = middle - (zoom @ (middle + shift)[..., None])[..., 0]
    grid = functional.affine_grid(torch.cat([zoom, offset[..., None]], 2), list(image.shape), align_corners=False)
    return functional.grid_sample(image, grid, align_corners=False)
