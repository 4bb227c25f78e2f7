"""Spherical harmonics up to degree 2: of an environment, and of the light on a face (Ramamoorthi and Hanrahan 2001)."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float64
from service.light.environment import pixel_directions, pixel_solid_angles
from service.robust import geman_mcclure

COSINE_LOBE = np.repeat([np.pi, 2.0 * np.pi / 3.0, np.pi / 4.0], [1, 3, 5])
"""(9,) factors of each coefficient when radiance is turned into irradiance."""


_C0, _C1, _C2 = 0.5 / np.sqrt(np.pi), np.sqrt(0.75 / np.pi), np.sqrt(3.75 / np.pi)
_C20, _C22 = 0.25 * np.sqrt(5 / np.pi), np.sqrt(0.9375 / np.pi)
"""Normalisation of the orders that share one: band 0, band 1, (2,-2) (2,-1) (2,1), (2,0), (2,2)."""


def basis(directions: AnyFloat) -> Float64:
    """(..., 9) values at unit directions (..., 3), in the order (0,0), (1,-1), (1,0), (1,1), (2,-2) ... (2,2).

    The polar axis of the functions is z.
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    first = [np.full_like(x, _C0), _C1 * y, _C1 * z, _C1 * x]
    second = [_C2 * x * y, _C2 * y * z, _C20 * (3.0 * z * z - 1.0), _C2 * x * z, _C22 * (x * x - y * y)]
    return np.stack(first + second, -1)


def gradient(directions: Float64, coefficients: Float64) -> Float64:
    """(N, 3) derivative of ``basis(d) @ coefficients`` by d, for directions (N, 3) and coefficients (9,)."""
    x, y, z = directions.T
    c = coefficients
    along_x = _C1 * c[3] + _C2 * (y * c[4] + z * c[7]) + 2 * _C22 * x * c[8]
    along_y = _C1 * c[1] + _C2 * (x * c[4] + z * c[5]) - 2 * _C22 * y * c[8]
    along_z = _C1 * c[2] + _C2 * (y * c[5] + x * c[7]) + 6 * _C20 * z * c[6]
    return np.stack([along_x, along_y, along_z], 1)


def project(radiance: AnyFloat) -> Float64:
    """(9, 3) coefficients of a latitude-longitude image (H, W, 3) of linear radiance."""
    height, width = radiance.shape[:2]
    weighted = basis(pixel_directions(height, width)) * pixel_solid_angles(height, width)[..., None]
    return np.asarray(np.einsum("hwk,hwc->kc", weighted, np.asarray(radiance, np.float64)))


def irradiance(coefficients: AnyFloat, normals: AnyFloat) -> Float64:
    """(..., 3) irradiance >= 0 on surfaces with unit normals (..., 3), without occlusion.

    Truncation at degree 2 rings for hard light; negative values are clipped to 0.
    """
    values = basis(normals) @ (COSINE_LOBE[:, None] * np.asarray(coefficients, np.float64))
    return np.asarray(np.maximum(values, 0.0))


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
