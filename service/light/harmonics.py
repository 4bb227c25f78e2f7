"""Real spherical harmonics up to degree 2 and the irradiance of distant light (Ramamoorthi and Hanrahan 2001)."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float64
from service.light.sphere import pixel_directions, pixel_solid_angles

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
