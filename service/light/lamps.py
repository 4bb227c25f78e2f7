"""Area lamps: the points on them from which soft shadows are sampled."""

from __future__ import annotations

import numpy as np

from service.arrays import Float64
from service.geometry.normals import normalise
from service.light.scene import PointLight
from service.light.sphere import GOLDEN_ANGLE

SHARP_RAD = 0.002
"""Angular radius as seen from the head below which a lamp counts as a point."""


def disc_of(light: PointLight, centre_m: Float64) -> Float64:
    """(S, 3) metres, points on the disc that faces the head, S = 1 to 16 (sunflower pattern).

    Args:
        light: the lamp.
        centre_m: (3,) middle of the head.
    """
    at = np.asarray(light.position_m, np.float64)
    towards = np.asarray(centre_m, np.float64) - at
    distance = max(float(np.linalg.norm(towards)), 1e-3)
    if light.radius_m / distance < SHARP_RAD:
        return at[None]
    axis = normalise(towards)
    right = np.cross(np.eye(3)[int(np.abs(axis).argmin())], axis)
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    count = int(min(16, 6 + 60 * light.radius_m / distance))
    # A lamp that reaches into the head would put samples on the head's far side.
    radius = min(light.radius_m, 0.9 * distance) * np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.arange(count) * GOLDEN_ANGLE
    return np.asarray(at + radius[:, None] * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up))
