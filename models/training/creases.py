"""Creases: lines where skin folds, dark in the photo because little light gets in, and deep.

The light stage's wrinkles are those of its subjects, few in a crop, and seen in lights of which most show them faintly.
These are drawn over any crop: relief into the normals, darkness and a shaded side into the albedo. How dark a line is
goes with how steep it is, and spots stay flat, so a network learns to take lines for relief and freckles for colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from models.colour import linear, srgb
from models.training.degrade import blur
from models.training.tasks import choice, uniform
from service.levels import FULL_SIZE

TEXEL_MM = 0.068
"""Of the full chart, on the cheeks."""
FULL_WIDTH = FULL_SIZE[0]

CREASED = 0.6
"""Share of crops that have creases."""
MOST_FOLDS, MOST_LINES = 3, 5
"""Of a crop, and how many lines side by side a fold has (crow's feet)."""
WIDTH_MM, STEEPNESS = (0.12, 0.9), (0.1, 0.9)
"""Ranges: standard deviation of the Gaussian across, and depth over it."""
BANK = 0.35
"""Height of the banks of a crease as a share of its depth; they are two and a half times as wide."""
DARKNESS, SHADE = (0.5, 1.1), (0.0, 0.6)
"""Ranges: -log albedo at the deepest place over the steepness, and -log albedo over the slope against the light."""
SCATTERED_MM = 0.25
"""Blur of slopes that diffuse normals see."""
PIECES = 14
"""Straight pieces of a line."""
HAIRY = 0.3
"""Share of hair from which on skin has no creases."""


@dataclass(frozen=True)
class Creases:
    """Relief of crops, and what of it is seen.

    Attributes:
        right: (N, 1, h, w) slope to the right.
        up: (N, 1, h, w) slope upwards.
        density: (N, 1, h, w) -log of what is left of the albedo.
        diffuse: (N, 2, h, w) slopes right and up that diffuse normals have.
    """

    right: Tensor
    up: Tensor
    density: Tensor
    diffuse: Tensor

    @classmethod
    def draw(cls, count: int, side: int, chart_width: Tensor, hair: Tensor, generator: torch.Generator) -> Creases:
        """Random creases.

        Args:
            count: of crops.
            side: of a crop in texels.
            chart_width: (N, 1, 1, 1) texels of the chart that each crop is from.
            hair: (N, 1, h, w) in [0, 1]; there is no crease under hair.
            generator: of all that is random.
        """
        bare = (blur(hair, 2.0) < HAIRY).float()
        bare = blur(bare, 2.0)
        height, dark = torch.zeros(count, 1, side, side), torch.zeros(count, 1, side, side)
        texel = TEXEL_MM * FULL_WIDTH / chart_width
        for n in range(count):
            if float(uniform(generator, 0.0, 1.0, 1)) < CREASED:
                for _ in range(1 + choice(generator, MOST_FOLDS)):
                    relief, seen = _fold(side, float(texel[n]), generator)
                    height[n, 0] += relief
                    dark[n, 0] = torch.maximum(dark[n, 0], seen)
        height = height * bare
        # Central differences; rows count downwards.
        padded = functional.pad(height, (1, 1, 1, 1), mode="replicate")
        right = (padded[:, :, 1:-1, 2:] - padded[:, :, 1:-1, :-2]) / (2.0 * texel)
        up = (padded[:, :, :-2, 1:-1] - padded[:, :, 2:, 1:-1]) / (2.0 * texel)
        turn = uniform(generator, 0.0, 2.0 * torch.pi, count, 1, 1, 1)
        against = right * torch.cos(turn) + up * torch.sin(turn)
        shade = uniform(generator, *SHADE, count, 1, 1, 1) * against
        sigma = SCATTERED_MM / float(texel.mean())
        return cls(right, up, dark * bare + shade, blur(torch.cat([right, up], 1), sigma))

    def seen(self, albedo: Tensor) -> Tensor:
        """sRGB-coded albedo (N, 3, h, w) with the creases' darkness and shade."""
        return srgb((linear(albedo) * torch.exp(-self.density)).clamp(0.0, 1.0))

    def onto(self, normal: Tensor, *, diffuse: bool) -> Tensor:
        """(N, 3, h, w) unit tangent normals with the creases' slopes added to their own."""
        slopes = self.diffuse if diffuse else torch.cat([self.right, self.up], 1)
        flat = normal[:, :2] / normal[:, 2:].clamp(min=0.1) - slopes
        return functional.normalize(torch.cat([flat, torch.ones_like(flat[:, :1])], 1), dim=1)


def _fold(side: int, texel: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """(h, w) height in mm and -log albedo of lines side by side; ``texel`` in mm."""
    turn, length = uniform(generator, 0.0, 2.0 * torch.pi, 1), uniform(generator, 0.4, 1.5, 1) * side
    along = torch.cat([torch.cos(turn), torch.sin(turn)])
    across = torch.stack([-along[1], along[0]])
    t = torch.linspace(-0.5, 0.5, PIECES + 1)[:, None]
    bow = float(uniform(generator, -0.3, 0.3, 1)) * length * (1.0 - 4.0 * t**2)
    curve = uniform(generator, 0.1, 0.9, 1, 2) * side + t * length * along + bow * across
    width = float(uniform(generator, WIDTH_MM[0] ** 0.5, WIDTH_MM[1] ** 0.5, 1)) ** 2 / texel
    lines = 1 + choice(generator, MOST_LINES) * int(float(uniform(generator, 0.0, 1.0, 1)) < 0.5)
    height, dark = torch.zeros(side, side), torch.zeros(side, side)
    darkness = float(uniform(generator, *DARKNESS, 1))
    for number in range(lines):
        spread = number * (3.0 + 3.0 * float(uniform(generator, 0.0, 1.0, 1))) * width
        steep = float(uniform(generator, *STEEPNESS, 1))
        wobble = uniform(generator, -1.0, 1.0, PIECES + 1, 1) * 0.2 * width
        distance, place = _distance(curve + across * (spread + wobble), side)
        own = max(width, 1.2)
        fade = torch.sin(torch.pi * place.clamp(0.02, 0.98)).sqrt()
        groove = torch.exp(-0.5 * (distance / own) ** 2)
        bank = torch.exp(-0.5 * (distance / (2.5 * own)) ** 2)
        depth = steep * own * texel * fade
        height -= depth * (groove - BANK * bank)
        dark = torch.maximum(dark, darkness * steep * fade * torch.exp(-0.5 * (distance / (0.9 * own)) ** 2))
    return height, dark


def _distance(curve: Tensor, side: int) -> tuple[Tensor, Tensor]:
    """(h, w) distance in texels to a polyline (P, 2) of x and y, and where on it the nearest point lies, in [0, 1]."""
    # Every second texel will do: distances are all but linear.
    axis = torch.arange(side // 2) * 2.0 + 1.0
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    points = torch.stack([x, y], -1).view(-1, 1, 2)
    begin, step = curve[:-1], curve[1:] - curve[:-1]
    length = step.square().sum(1).clamp(min=1e-6)
    share = (((points - begin) * step).sum(2) / length).clamp(0.0, 1.0)
    square, index = (points - begin - share[..., None] * step).square().sum(2).min(1)
    place = (index + share.gather(1, index[:, None])[:, 0]) / len(begin)
    found = torch.stack([square.clamp(min=1e-12).sqrt(), place]).view(1, 2, side // 2, side // 2)
    distance, along = functional.interpolate(found, (side, side), mode="bilinear", align_corners=False)[0]
    return distance, along
