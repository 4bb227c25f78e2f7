"""Reflection of the environment in a rough surface: prefiltered once per environment and roughness."""

from __future__ import annotations

import functools

import numpy as np

from service.arrays import AnyFloat, Float32
from service.light.sphere import pixel_directions, pixel_solid_angles

ALPHAS = (0.08, 0.16, 0.27, 0.42, 0.64, 1.0)
"""GGX alpha of each level; smoother surfaces use the first."""

SIZE = (32, 64)
"""Rows and columns of each level."""


@functools.lru_cache(maxsize=len(ALPHAS))
def _kernel(alpha: float) -> Float32:
    """(out pixels, in pixels) weights of radiance for each mirror direction, viewed along the normal (Karis 2013)."""
    seen = pixel_directions(*SIZE).reshape(-1, 3).astype(np.float32)
    cosine = np.clip(seen @ seen.T, -1.0, 1.0)  # of twice the angle between normal and half vector
    n_h2 = 0.5 * (1.0 + cosine)
    d = 1.0 - n_h2 * (1.0 - alpha * alpha)
    weight = np.maximum(cosine, 0.0) / (d * d) * pixel_solid_angles(*SIZE).ravel().astype(np.float32)
    return np.asarray(weight / weight.sum(1, keepdims=True), np.float32)


def prefiltered(sky: AnyFloat) -> Float32:
    """(6, 3, 32, 64) float32 linear radiance for each of ``ALPHAS`` and each mirror direction; about 0.1 s.

    Args:
        sky: (H, W, 3) linear radiance, sides multiples of 32 and 64.
    """
    rows, columns = sky.shape[0] // SIZE[0], sky.shape[1] // SIZE[1]
    small = np.asarray(sky, np.float32).reshape(SIZE[0], rows, SIZE[1], columns, 3).mean((1, 3)).reshape(-1, 3)
    levels = [(_kernel(alpha) @ small).reshape(*SIZE, 3).transpose(2, 0, 1) for alpha in ALPHAS]
    return np.ascontiguousarray(np.stack(levels), np.float32)
