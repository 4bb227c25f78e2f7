"""The light's formulas as modules of tensors alone, for ``export.light``: what the service relights avatars with.

Each module calls the very functions that the light stage bakes with. Lists of points are maps of one row. Units: mm for
positions of points, metres for lamps, linear light; directions are unit vectors in head space.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from models.lightstage.light import scatter, visibility
from models.lightstage.light.bake import Lamp, arriving_at, facing, highlight, mirrored
from models.lightstage.light.lobes import Gloss, directional_albedo
from models.lightstage.light.reflection import Mirror
from models.lightstage.light.sampling import dot
from models.lightstage.light.visibility import Points
from service.light.formulas import F0_SCALE, SMALLEST_ALPHA

DENSEST = 12.0
"""Texels per mm up to which scattering keeps its width; wider maps than a render needs."""


class FromDirection(nn.Module):
    """Share of parallel light that reaches points."""

    def forward(
        self, occluders: Tensor, points: Tensor, direction: Tensor, spacing_mm: Tensor, blank: Tensor
    ) -> Tensor:
        """(N,) of occluders (3, M), points (6, N): position and normal, direction (3,), depth map (S, S) of -1e30.

        The depth map has to have as many cells a side as the occluders need; see ``visibility.View``.
        """
        view = visibility.along(occluders.T, spacing_mm, direction)
        return visibility.reached_from_direction(view, blank, Points(points[:3], points[3:]), direction)


class FromPoint(nn.Module):
    """Share of a point's light that reaches points."""

    def forward(self, occluders: Tensor, points: Tensor, light_mm: Tensor, spacing_mm: Tensor, blank: Tensor) -> Tensor:
        """(N,) as ``FromDirection``, of a light at (3,)."""
        view = visibility.around(occluders.T, spacing_mm, light_mm)
        return visibility.reached_from_point(view, blank, occluders.T, Points(points[:3], points[3:]), light_mm)


class Irradiance(nn.Module):
    """Light of a lamp on a matt surface."""

    def forward(
        self, position: Tensor, normal: Tensor, shade: Tensor, at: Tensor, intensity: Tensor, radius: Tensor
    ) -> Tensor:
        """(3, h, w) irradiance; position and normal (3, h, w), shade (h, w) the share of the lamp that arrives."""
        towards, _, irradiance, size = arriving_at(position, at, intensity, radius)
        return irradiance * (shade * facing(dot(normal, towards), size))


class Kept(nn.Module):
    """Directional albedo of one lobe; what it mirrors is missing from what the skin scatters."""

    def __init__(self, *, rising: bool) -> None:
        super().__init__()
        self.rising = rising

    def forward(self, view: Tensor, normal: Tensor, specular: Tensor, alpha: Tensor) -> Tensor:
        """(h, w) in [0, 1] of unit view and normal (3, h, w), specular albedo and GGX alpha (h, w)."""
        n_v = dot(normal, view).clamp(1e-3, 1.0)
        f0 = F0_SCALE * specular.clamp(0.0, 1.0)
        return directional_albedo(f0, alpha.clamp(SMALLEST_ALPHA, 1.0), n_v, rising=self.rising)


class Highlight(nn.Module):
    """Mirror-like reflection of a lamp by one lobe."""

    def __init__(self, *, rising: bool) -> None:
        super().__init__()
        self.rising = rising

    def forward(
        self, position: Tensor, view: Tensor, normal: Tensor, shade: Tensor, specular: Tensor, alpha: Tensor,
        at: Tensor, intensity: Tensor, radius: Tensor,
    ) -> Tensor:  # fmt: skip
        """(3, h, w) radiance towards ``view``."""
        lobe = alpha.clamp(SMALLEST_ALPHA, 1.0)
        gloss = Gloss(F0_SCALE * specular.clamp(0.0, 1.0), (lobe,), (torch.ones_like(lobe),))
        towards, distance, irradiance, size = arriving_at(position, at, intensity, radius)
        lamp = Lamp(towards, distance, irradiance, shade, size)
        return highlight(view, normal, gloss, lamp, rising=self.rising)


class Reflection(nn.Module):
    """The sky in the mirror of one lobe."""

    def forward(
        self, levels: Tensor, view: Tensor, normal: Tensor, part: Tensor, alpha: Tensor, openness: Tensor
    ) -> Tensor:
        """(3, h, w) radiance; levels are ``service.light.environment.prefiltered``, part (h, w) is that of ``Kept``."""
        return mirrored(Mirror(levels), view, normal, part, alpha.clamp(SMALLEST_ALPHA, 1.0), openness)


class Scattering(nn.Module):
    """Light that wanders under the skin."""

    def forward(self, albedo: Tensor, arriving: Tensor, texels_per_mm: Tensor, mask: Tensor) -> Tensor:
        """(3, h, w) radiosity of linear albedo and irradiance (3, h, w); texels_per_mm and mask (h, w)."""
        root = albedo.clamp(0.0, 1.0).sqrt()
        return root * scatter.scattered(root * arriving, texels_per_mm, mask, DENSEST)
