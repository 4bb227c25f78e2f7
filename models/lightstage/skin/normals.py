"""Normals from height, and the diffuse normals that light scattered under the skin seems to see."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from models.lightstage.skin.atlas import Metric
from models.lightstage.skin.stack import GaussianStack

# Sum of Gaussians of skin (d'Eon and Luebke, GPU Gems 3, ch. 14): variance in mm^2, weights of red, green, blue. The
# widest of the original six (7.41 mm^2, weight 0.078 of red) is merged into the fifth: it would enlarge every halo by
# half for 1.6 % of the normal.
PROFILE: tuple[tuple[float, tuple[float, float, float]], ...] = (
    (0.0064, (0.233, 0.455, 0.649)),
    (0.0484, (0.100, 0.336, 0.344)),
    (0.187, (0.118, 0.198, 0.0)),
    (0.567, (0.113, 0.007, 0.007)),
    (1.99, (0.436, 0.004, 0.0)),
)
LUMA = (0.21, 0.72, 0.07)
_STEEPEST = 2.5


def normals_of(height_mm: Tensor, metric: Metric) -> Tensor:
    """(3, h, w) unit tangent normals of a (h, w) height; slopes beyond 68 degrees are cut."""
    a, b = metric.gradient(height_mm)
    x, y = (-a).clamp(-_STEEPEST, _STEEPEST), (-b).clamp(-_STEEPEST, _STEEPEST)
    z = (1.0 + x * x + y * y).rsqrt()
    return torch.stack([x * z, y * z, z])


def unit(vectors: Tensor) -> Tensor:
    """(3, h, w) unit vectors; (0, 0, 1) where there is no direction."""
    length = vectors.square().sum(0).sqrt()
    up = torch.zeros_like(vectors)
    up[2] = 1.0
    return torch.where(length > 1e-6, vectors / length.clamp(min=1e-6), up)


def diffuse_normals(
    normal: Tensor, texels_per_mm: Tensor, hair: Tensor, scale: float, widest: float, finest: float
) -> Tensor:
    """(3, h, w): normals blurred by the scattering profile of each colour, made unit, and mixed by luminance.

    Args:
        normal: (3, h, w) specular normals, tangent space.
        texels_per_mm: (h, w) so that blurs have their width in mm everywhere; the stretch of the chart (its anisotropy)
            is left out of account.
        hair: (h, w) cover; hair is no part of the skin and its normals are not blurred into it.
        scale: width of the profile relative to the published one.
        widest: blurs (sigma in texels) are cut to this, the same for all windows of a chart size.
        finest: densities (texels per mm) are cut to this, likewise.
    """
    weight = 1.0 - hair
    slopes = torch.cat([normal[:2] * weight, weight[None]])
    stack = GaussianStack.build(slopes, widest)
    mixed = torch.zeros_like(normal)
    for colour, luma in enumerate(LUMA):
        mixtures = [(math.sqrt(v) * scale, w[colour]) for v, w in PROFILE if w[colour] > 0]
        x, y, share = stack.at(texels_per_mm, mixtures, finest)
        share = share.clamp(min=1e-3)
        x, y = x / share, y / share
        z = (1.0 - x * x - y * y).clamp(min=1e-4).sqrt()
        mixed = mixed + luma * torch.stack([x, y, z])
    return unit(mixed)
