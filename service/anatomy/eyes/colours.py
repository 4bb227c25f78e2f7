"""Colours of eyes: the one place to change them. All are diffuse albedo, linear RGB in [0, 1]."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.colour import luma

SCLERA = np.array([0.63, 0.59, 0.56], np.float32)
"""Sclera: nearly grey and much the same in everybody; its blood vessels make it slightly red."""

IRIS = np.array([0.099, 0.054, 0.032], np.float32)
"""Iris assumed where the photo does not show its colour: medium brown, the most frequent."""

SOCKET = np.array([0.358, 0.127, 0.108], np.float32)
"""Conjunctiva between eyeball and lids."""

BRIGHTEST = 0.85
"""Largest albedo of an eye or a tooth."""

MOST_IRIS_LUMA, MOST_IRIS_CHANNEL = 0.2, 0.32
"""Largest luminance of an iris, and its largest channel. Without these limits an iris would glow where the sclera,
which tells the light, lies in the lids' shade, or where skin was mistaken for an iris."""

DARKEST_IRIS = np.array([0.020, 0.014, 0.010], np.float32)
"""Lower limit of each channel of an iris."""

MOST_RED, LEAST_BLUE = 2.5, 0.4
"""Red over green and blue over green of the brownest iris."""


def likely_iris(albedo: Float32) -> Float32:
    """(3,) a measured albedo (3,) >= 0, limited to what irises have: brightness, and neither purple nor red.

    Brown, green, blue and grey irises have at least as much green as the geometric mean of red and blue. A purple
    measurement is a brown iris that mirrors the sky; a red one is a brown iris in the light of a lamp or a flash.
    """
    red, green, blue = np.maximum(albedo, np.float32(1e-4))
    linear = np.array([red, green, min(blue, green * green / red)], np.float32)
    if red > MOST_RED * green:
        brown = np.array([MOST_RED, 1.0, max(linear[2] / green, LEAST_BLUE)], np.float32)
        linear = brown * np.float32(luma(linear) / luma(brown))
    excess = max(1.0, float(luma(linear)) / MOST_IRIS_LUMA, float(linear.max()) / MOST_IRIS_CHANNEL)
    return np.asarray(np.maximum(linear / np.float32(excess), DARKEST_IRIS), np.float32)
