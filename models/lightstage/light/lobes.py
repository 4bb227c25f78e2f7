"""Mirror-like reflection of skin: two GGX lobes with Schlick's Fresnel term (Walter et al. 2007).

The shadowing term is Smith's exact one for GGX, uncorrelated, rather than Schlick's fit to it: it costs as much and the
furnace test holds exactly.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from service.arrays import Float64
from service.light.formulas import F0_SCALE, SMALLEST_ALPHA

COSINES, ALPHAS = 32, 32
"""Rows and columns of the table of directional albedo."""


@dataclass(frozen=True)
class Gloss:
    """Surface terms of the mirror-like reflection, (h, w) each: F0, alpha of both lobes, share of the first."""

    f0: Tensor
    alphas: tuple[Tensor, ...]
    shares: tuple[Tensor, ...]

    @classmethod
    def of(cls, specular_albedo: Tensor, roughness: Tensor, two_lobes: bool) -> Gloss:
        """From (1, h, w) specular albedo and (3, h, w) roughness (alpha, alpha, share of the first lobe).

        With one lobe its alpha is the mean of both by share.
        """
        first, second = roughness[0].clamp(SMALLEST_ALPHA, 1.0), roughness[1].clamp(SMALLEST_ALPHA, 1.0)
        share = roughness[2].clamp(0.0, 1.0)
        f0 = F0_SCALE * specular_albedo[0].clamp(0.0, 1.0)
        if two_lobes:
            return cls(f0, (first, second), (share, 1.0 - share))
        return cls(f0, (second + (first - second) * share,), (torch.ones_like(share),))


def ggx(alpha: Tensor, n_h_sine2: Tensor, n_l: Tensor, n_v: Tensor) -> Tensor:
    """D G / (4 n.l n.v) in 1/sr for squared sine of the angle between normal and half vector.

    The sine is given rather than the cosine so that nothing cancels near the mirror direction.
    """
    a2 = alpha * alpha
    d = n_h_sine2 + a2 * (1.0 - n_h_sine2)
    reach = (n_l + (a2 + (1.0 - a2) * n_l * n_l).sqrt()) * (n_v + (a2 + (1.0 - a2) * n_v * n_v).sqrt())
    return a2 / (math.pi * d * d * reach.clamp(min=1e-4))


def fresnel(f0: Tensor, v_h: Tensor) -> Tensor:
    """Schlick 1994."""
    x = (1.0 - v_h).clamp(0.0, 1.0)
    x2 = x * x
    return f0 + (1.0 - f0) * (x2 * x2 * x)


@functools.lru_cache(maxsize=1)
def albedo_table() -> Float64:
    """(2, 32, 32): directional albedo is f0 * scale + bias; rows are cosines (i + 0.5) / 32, columns alphas likewise.

    Integrated over half vectors that are spread by D n.h: tan^2 = alpha^2 u / (1 - u).
    """
    u = (np.arange(32) + 0.5) / 32
    cosine = (np.arange(COSINES) + 0.5) / COSINES
    alpha = np.maximum((np.arange(ALPHAS) + 0.5) / ALPHAS, SMALLEST_ALPHA)
    a2 = (alpha**2)[None, :, None, None]
    h_z = (1.0 / np.sqrt(1.0 + alpha[:, None] ** 2 * (u / (1.0 - u))))[None, :, :, None]
    h_x = np.sqrt(np.maximum(1.0 - h_z**2, 0.0)) * np.cos(np.pi * u)
    v_z = cosine[:, None, None, None]
    v_h = np.sqrt(1.0 - v_z**2) * h_x + v_z * h_z
    l_z = 2.0 * v_h * h_z - v_z

    def masking(c: Float64) -> Float64:
        return np.asarray(2.0 * c / (c + np.sqrt(a2 + (1.0 - a2) * c * c)))

    weight = masking(v_z) * masking(np.maximum(l_z, 1e-6)) * np.maximum(v_h, 0.0) / (v_z * h_z)
    weight = np.where((l_z > 0) & (v_h > 0), weight, 0.0)
    rise = (1.0 - np.clip(v_h, 0.0, 1.0)) ** 5
    return np.stack([(weight * (1.0 - rise)).mean((-1, -2)), (weight * rise).mean((-1, -2))])


@functools.lru_cache(maxsize=4)
def _table(device: str) -> Tensor:
    """``albedo_table`` on a device."""
    return torch.from_numpy(albedo_table()).float().to(device)


def directional_albedo(f0: Tensor, alpha: Tensor, n_v: Tensor, *, rising: bool = True) -> Tensor:
    """(h, w) share of even light that a lobe sends to the viewer, at most 1; no Fresnel rise where not ``rising``."""
    table = _table(str(alpha.device)).to(alpha.dtype)
    row = (n_v * COSINES - 0.5).clamp(0.0, COSINES - 1.0)
    column = (alpha * ALPHAS - 0.5).clamp(0.0, ALPHAS - 1.0)
    r0, c0 = row.floor().clamp(max=COSINES - 2), column.floor().clamp(max=ALPHAS - 2)
    fr, fc = row - r0, column - c0
    r, c = r0.long(), c0.long()
    upper = torch.lerp(table[:, r, c], table[:, r, c + 1], fc)
    lower = torch.lerp(table[:, r + 1, c], table[:, r + 1, c + 1], fc)
    scale, bias = torch.lerp(upper, lower, fr)
    albedo = f0 * scale + bias if rising else f0 * (scale + bias)
    return albedo.clamp(0.0, 1.0)
