"""Shadows that pores and wrinkles cast on themselves: the horizon of the height field towards a light."""

from __future__ import annotations

import torch
from torch import Tensor

from models.lightstage.light.geometry import Site
from models.lightstage.light.sampling import displaced

STEPS_MM = (0.2, 0.5, 1.0)
_SOFT = 0.08


def reach(texels_per_mm: float) -> int:
    """Texels beyond a window that its shadows depend on."""
    return int(STEPS_MM[-1] * texels_per_mm * 2.0) + 2


def relief_shadow(height_mm: Tensor, towards: Tensor, site: Site) -> Tensor:
    """(h, w) share in [0, 1] of a light that the fine relief lets through.

    Args:
        height_mm: (1, h, w).
        towards: (3, h, w) unit directions to the light, tangent space.
        site: texels per mm.
    """
    x, y, z = towards
    across = (x * x + y * y).sqrt()
    x, y = x / across.clamp(min=1e-4), y / across.clamp(min=1e-4)
    slope = z / across.clamp(min=1e-4)
    height = height_mm[0].float()
    right, up = (site.step[0, 0] * x + site.step[0, 1] * y), (site.step[1, 0] * x + site.step[1, 1] * y)
    horizon = torch.zeros_like(slope)
    for step in STEPS_MM:
        beside = displaced(height, (right * step).clamp(-64, 64), (up * step).clamp(-64, 64))
        horizon = torch.maximum(horizon, (beside - height) / step)
    return ((slope - horizon) / _SOFT + 1.0).clamp(0.0, 1.0)
