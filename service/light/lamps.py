"""Lamps that are not points: where on them their shadows are taken from."""

from __future__ import annotations

import numpy as np

from service.arrays import Float64
from service.geometry.normals import normalise
from service.light.scene import PointLight

SHARP_RAD = 0.002
"""Lamps that look smaller than this from the head are points."""

_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


def disc_of(light: PointLight, centre_m: Float64) -> Float64:
    """(S, 3) metres, points on the disc that a lamp shows to a head, S = 1 to 16 (sunflower pattern).

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
    # A ball that reaches into the head would put samples on its far side.
    radius = min(light.radius_m, 0.9 * distance) * np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.arange(count) * _GOLDEN
    return np.asarray(at + radius[:, None] * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up))
