"""Conditions of the photo that make a fit less certain: an under-exposed face, covered eyes."""

from __future__ import annotations

import cv2
import numpy as np

from service.arrays import Float64, UInt8
from service.colour import bytes_to_linear
from service.light.harmonics import LUMINANCE

Pixels = UInt8

EYES = (
    (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7),
    (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249),
)
"""Landmarks around the image-left and image-right eye, in order."""
CHEEKS = ((116, 117, 118, 101, 205, 187, 147, 123), (345, 346, 347, 330, 425, 411, 376, 352))
"""Landmarks around the cheek below each of ``EYES``, in order."""
OVAL = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
"""Landmarks around the face, in order."""

DARK = 0.05
"""75th percentile of a face's linear luminance below which it is under-exposed (dark skin in good light has 0.15)."""
EYE_GROWTH = 1.6
"""Factor by which eye outlines are enlarged about their centre, to take in lids and lashes."""
COVERED_LEVEL, COVERED_CONTRAST = 0.35, 0.4
"""An eye counts as covered if its 75th percentile of luminance is below the first factor times the cheek's median, and
its interquartile range is at most the second factor times its mean.

The second ratio is 0.55 to 1.8 in 17 photos of uncovered eyes, some in hard shadow. Quartiles ignore glints."""


def warnings(pixels: Pixels, landmarks: Float64) -> tuple[str, ...]:
    """Stable codes for one face: ``under-exposed``, ``eyes-covered`` (both eyes dark and featureless: sunglasses).

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: (468, 3) float64 photo pixels.
    """
    codes = []
    face = _luminance(pixels, landmarks[list(OVAL), :2])
    if face.size and float(np.percentile(face, 75)) < DARK:
        codes.append("under-exposed")
    pairs = zip(EYES, CHEEKS, strict=True)
    if all(_covered(pixels, landmarks[list(eye), :2], landmarks[list(cheek), :2]) for eye, cheek in pairs):
        codes.append("eyes-covered")
    return tuple(codes)


def _covered(pixels: Pixels, eye: Float64, cheek: Float64) -> bool:
    """Whether an eye is much darker than its cheek and without contrast; False where either is out of view."""
    centre = eye.mean(0)
    inside, skin = _luminance(pixels, centre + (eye - centre) * EYE_GROWTH), _luminance(pixels, cheek)
    if not inside.size or not skin.size:
        return False
    low, high = (float(v) for v in np.percentile(inside, (25, 75)))
    return high < COVERED_LEVEL * float(np.median(skin)) and high - low <= COVERED_CONTRAST * float(inside.mean())


def _luminance(pixels: Pixels, polygon: Float64) -> Float64:
    """(M,) linear luminance in [0, 1] of the pixels inside an (N, 2) polygon; empty where it lies outside the photo."""
    height, width = pixels.shape[:2]
    x0, y0 = np.clip(np.floor(polygon.min(0)), 0, [width, height]).astype(int)
    x1, y1 = np.clip(np.ceil(polygon.max(0)), 0, [width, height]).astype(int)
    if x1 <= x0 or y1 <= y0:
        return np.zeros(0)
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    corners = np.round(polygon - [x0, y0] - 0.5).astype(np.int32)  # OpenCV puts pixel centres at integers
    cv2.fillPoly(mask, [corners], [1])
    return np.asarray(bytes_to_linear(pixels[y0:y1, x0:x1][mask > 0]) @ LUMINANCE)
