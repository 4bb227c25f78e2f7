"""Real spherical harmonics up to degree 2 and the irradiance of distant light (Ramamoorthi and Hanrahan 2001)."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float64
from service.light.sphere import pixel_directions, pixel_solid_angles

COSINE_LOBE = np.repeat([np.pi, 2.0 * np.pi / 3.0, np.pi / 4.0], [1, 3, 5])
"""(9,) factors of each coefficient when radiance is turned into irradiance."""


def basis(directions: AnyFloat) -> Float64:
    """(..., 9) values at unit directions (..., 3), in the order (0,0), (1,-1), (1,0), (1,1), (2,-2) ... (2,2).

    The polar axis of the functions is z.
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    return np.stack(
        [
            np.full_like(x, 0.28209479177387814),
            0.4886025119029199 * y,
            0.4886025119029199 * z,
            0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            1.0925484305920792 * y * z,
            0.31539156525252005 * (3.0 * z * z - 1.0),
            1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ],
        -1,
    )


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
