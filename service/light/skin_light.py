"""Light on the face as second-order spherical harmonics (Ramamoorthi and Hanrahan, SIGGRAPH 2001)."""

from __future__ import annotations

import numpy as np

from service.arrays import Float64
from service.light.harmonics import COSINE_LOBE, basis
from service.robust import geman_mcclure

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear R, G, B (ITU-R BT.709) in float64; ``service.colour.LUMA`` is float32."""

BAND_GAIN = COSINE_LOBE / np.pi
"""Clamped-cosine transfer A_l / pi of the bands 0, 1, 2."""
RIDGE = 1e-3
"""Ridge over the trace of the normal matrix: half the sphere of normals is never visible, so it is near singular."""


def sh_basis(normals: Float64) -> Float64:
    """(N, 3) unit normals -> (N, 9) irradiance basis: harmonics times A_l / pi, so that ``basis @ light`` is E / pi."""
    return np.asarray(basis(normals) * BAND_GAIN, np.float64)


def estimate_light(normals: Float64, colours: Float64, weights: Float64, rounds: int = 4) -> Float64 | None:
    """Estimate the light from skin colours, up to the skin's unknown mean albedo.

    Ridge regression with robust weights: brows, lips and cast shadows are outliers of a one-albedo model.

    Args:
        normals: (N, 3) unit, any frame; the light is in the same.
        colours: (N, 3) linear RGB in [0, 1].
        weights: (N,) >= 0.
        rounds: number of re-weightings.

    Returns:
        (9, 3) coefficients scaled so that E / pi has a mean luminance of one over the skin; None where fewer than 30
        points have weight or the skin is black.
    """
    used = (weights > 0) & np.isfinite(colours).all(1) & np.isfinite(normals).all(1)
    if int(used.sum()) < 30:
        return None
    rows, colour, weight = sh_basis(normals[used]), colours[used], weights[used]
    robust: Float64 = np.ones(len(weight))
    light: Float64 = np.zeros((9, 3))
    for _ in range(rounds):
        w = (weight * robust)[:, None]
        gram = rows.T @ (w * rows)
        gram += np.eye(9) * max(RIDGE * float(np.trace(gram)), 1e-12)
        light = np.asarray(np.linalg.solve(gram, rows.T @ (w * colour)), np.float64)
        residual = np.abs(colour - rows @ light).mean(1)
        spread = max(1.4826 * float(np.median(residual)), 1e-4)
        robust = geman_mcclure(residual, 2.5 * spread)
    mean = float(weight @ ((rows @ light) @ LUMINANCE) / weight.sum())
    if not np.isfinite(light).all() or mean < 1e-4:
        return None
    return np.asarray(light / mean)
