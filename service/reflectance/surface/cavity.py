"""Cavity: how much of the sky the relief leaves open, in pores, folds and wrinkles."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, UInt16
from service.reflectance.result import SCALE_MM

FINE = (0.25, 0.03)
COARSE = (0.8, 0.06)
"""Standard deviation of the blur whose depth counts, and the depth that hides a sky, both in mm: the light stage's
(``models/lightstage/skin/gloss.py``)."""

WIDEST = 16.0
"""Largest standard deviation in texels; a head smaller than a thumb would ask for more."""

STRENGTH = 1.5
FLOOR = 0.35
"""Even the deepest pore sees this share."""


def cavity(displacement: UInt16, texel_mm: float, size: tuple[int, int]) -> Float32:
    """(h, w) float32 in [``FLOOR``, 1] of a displacement map (H, W).

    The depth below the mean of the surroundings at two scales, through exp(-depth).

    Args:
        displacement: codes of heights, ``SCALE_MM`` apart.
        texel_mm: size of a texel of the result on the face, mm.
        size: (width, height) of the result.
    """
    import cv2

    height = np.asarray(cv2.resize(displacement, size, interpolation=cv2.INTER_AREA), np.float32) * np.float32(SCALE_MM)
    depth = np.zeros_like(height)
    for sigma_mm, hidden_mm in (FINE, COARSE):
        sigma = min(max(sigma_mm / max(texel_mm, 1e-6), 0.3), WIDEST)
        mean = np.asarray(cv2.GaussianBlur(height, (0, 0), sigma), np.float32)
        depth += np.maximum(mean - height, 0) / np.float32(hidden_mm)
    return np.asarray(FLOOR + (1 - FLOOR) * np.exp(-STRENGTH * depth), np.float32)
