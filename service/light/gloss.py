"""Specular reflection of skin: a table of a GGX lobe's directional albedo, and an approximate reflection of the sky.

The lobe itself is evaluated by the graphs exported from ``models/lightstage/light`` (``service.light.graphs``), which
use the table made here (Walter et al. 2007; Karis 2013; Lagarde and de Rousiers 2014).
"""

from __future__ import annotations

import functools

import numpy as np

from service.arrays import Float64

F0_SCALE = 0.04
"""Reflectance at normal incidence of specular albedo 1 (glTF's default)."""

SMALLEST_ALPHA = 0.03
"""GGX alpha below which lobes are not made narrower."""
COSINES, ALPHAS = 32, 32
"""Rows and columns of the table of directional albedo."""


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


def mirror_weights(reflected: Float64, alpha: Float64, directions: Float64) -> Float64:
    """(K, D) weights, sum 1, of the radiance of D directions in the reflection at K rough points."""
    cosine = np.clip(reflected @ directions.T, -1.0, 1.0)
    d = 1.0 - 0.5 * (1.0 + cosine) * (1.0 - np.clip(alpha, 0.08, 1.0)[:, None] ** 2)
    weight = np.maximum(cosine, 0.0) / (d * d)
    return np.asarray(weight / np.maximum(weight.sum(1, keepdims=True), 1e-12))


def mirror_openness(openness: Float64, n_v: Float64, alpha: Float64) -> Float64:
    """Specular occlusion in [0, 1] of a lobe from ambient occlusion (Lagarde and de Rousiers 2014)."""
    power = np.exp2(-16.0 * np.sqrt(np.clip(alpha, SMALLEST_ALPHA, 1.0)) - 1.0)
    return np.asarray(np.clip(np.maximum(n_v + openness, 0.0) ** power - 1.0 + openness, 0.0, 1.0))
