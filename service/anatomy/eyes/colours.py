"""Colours of eyes: the one place to change them. All are diffuse albedo, linear RGB in [0, 1]."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import luma

Float = npt.NDArray[np.float32]

SCLERA = np.array([0.63, 0.59, 0.56], np.float32)
"""Sclera: nearly grey and much the same in everybody, a little redder for its vessels."""

IRIS = np.array([0.099, 0.054, 0.032], np.float32)
"""Iris of an eye whose colour was not seen: medium brown, the most frequent."""

SOCKET = np.array([0.358, 0.127, 0.108], np.float32)
"""Conjunctiva between eyeball and lids."""

BRIGHTEST = 0.85
"""Largest albedo of an eye or a tooth."""

LIGHTEST_IRIS, MOST_IRIS = 0.2, 0.32
"""Luminance of the palest iris and its largest channel: a sclera seen in the shade of the lids, or skin taken for an
iris, would make it glow."""
LEAST_IRIS = np.array([0.020, 0.014, 0.010], np.float32)
"""Channels of the darkest iris."""
REDDEST_IRIS, LEAST_BLUE = 2.5, 0.4
"""Red and blue over green of the brownest iris."""


def likely_iris(albedo: Float) -> Float:
    """(3,) albedo nearest to (3,) >= 0 that irises have: no brighter, no darker, neither purple nor red.

    Brown, green, blue and grey irises have at least as much green as the geometric mean of red and blue. A purple one
    is brown with the blue of the sky in it; a red one is brown in the light of a lamp or a flash.
    """
    red, green, blue = np.maximum(albedo, np.float32(1e-4))
    linear = np.array([red, green, min(blue, green * green / red)], np.float32)
    if red > REDDEST_IRIS * green:
        brown = np.array([REDDEST_IRIS, 1.0, max(linear[2] / green, LEAST_BLUE)], np.float32)
        linear = brown * np.float32(luma(linear) / luma(brown))
    excess = max(1.0, float(luma(linear)) / LIGHTEST_IRIS, float(linear.max()) / MOST_IRIS)
    return np.asarray(np.maximum(linear / np.float32(excess), LEAST_IRIS), np.float32)
