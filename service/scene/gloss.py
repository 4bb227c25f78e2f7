"""Mirror-like reflection of skin in numpy: a GGX lobe, its directional albedo, the sky in its mirror.

The same formulas as ``models/lightstage/light`` bakes with, for the planner's samples; the table of directional albedo
is made here and used by both (Walter et al. 2007; Karis 2013; Lagarde and de Rousiers 2014).
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

F0_SCALE = 0.04
"""Reflectance at normal incidence of specular albedo 1 (glTF's default)."""

SMALLEST_ALPHA = 0.03
COSINES, ALPHAS = 32, 32
"""Rows and columns of the table of directional albedo."""


@functools.lru_cache(maxsize=1)
def albedo_table() -> Array:
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

    def masking(c: Array) -> Array:
        return np.asarray(2.0 * c / (c + np.sqrt(a2 + (1.0 - a2) * c * c)))

    weight = masking(v_z) * masking(np.maximum(l_z, 1e-6)) * np.maximum(v_h, 0.0) / (v_z * h_z)
    weight = np.where((l_z > 0) & (v_h > 0), weight, 0.0)
    rise = (1.0 - np.clip(v_h, 0.0, 1.0)) ** 5
    return np.stack([(weight * (1.0 - rise)).mean((-1, -2)), (weight * rise).mean((-1, -2))])


def directional_albedo(f0: Array, alpha: Array, n_v: Array, *, rising: bool = True) -> Array:
    """Share in [0, 1] of even light that a lobe sends to the viewer; no Fresnel rise where not ``rising``."""
    table = albedo_table()
    row = np.clip(n_v * COSINES - 0.5, 0.0, COSINES - 1.0)
    column = np.clip(alpha * ALPHAS - 0.5, 0.0, ALPHAS - 1.0)
    r, c = (np.minimum(np.floor(x), n - 2).astype(int) for x, n in ((row, COSINES), (column, ALPHAS)))
    fr, fc = row - r, column - c
    upper = table[:, r, c] * (1 - fc) + table[:, r, c + 1] * fc
    lower = table[:, r + 1, c] * (1 - fc) + table[:, r + 1, c + 1] * fc
    scale, bias = upper * (1 - fr) + lower * fr
    return np.asarray(np.clip(f0 * scale + bias if rising else f0 * (scale + bias), 0.0, 1.0))


def ggx(alpha: Array, n_h_sine2: Array, n_l: Array, n_v: Array) -> Array:
    """D G / (4 n.l n.v) in 1/sr for squared sine of the angle between normal and half vector."""
    a2 = alpha * alpha
    d = n_h_sine2 + a2 * (1.0 - n_h_sine2)
    reach = (n_l + np.sqrt(a2 + (1 - a2) * n_l * n_l)) * (n_v + np.sqrt(a2 + (1 - a2) * n_v * n_v))
    return np.asarray(a2 / (np.pi * d * d * np.maximum(reach, 1e-4)))


def facing(cosine: Array, size: Array) -> Array:
    """Irradiance factor of a ball of sine ``size`` whose centre is at ``cosine``, part of it below the horizon."""
    wrapped = (cosine + size) ** 2 / (4.0 * size)
    return np.asarray(np.where(np.abs(cosine) < size, wrapped, np.maximum(cosine, 0.0)))


def mirror_weights(reflected: Array, alpha: Array, directions: Array) -> Array:
    """(K, D) shares, sum 1, of the radiance of D directions in the mirror of K rough points."""
    cosine = np.clip(reflected @ directions.T, -1.0, 1.0)
    d = 1.0 - 0.5 * (1.0 + cosine) * (1.0 - np.clip(alpha, 0.08, 1.0)[:, None] ** 2)
    weight = np.maximum(cosine, 0.0) / (d * d)
    return np.asarray(weight / np.maximum(weight.sum(1, keepdims=True), 1e-12))


def mirror_openness(openness: Array, n_v: Array, alpha: Array) -> Array:
    """Occlusion of a lobe from ambient occlusion."""
    power = np.exp2(-16.0 * np.sqrt(np.clip(alpha, SMALLEST_ALPHA, 1.0)) - 1.0)
    return np.asarray(np.clip(np.maximum(n_v + openness, 0.0) ** power - 1.0 + openness, 0.0, 1.0))
