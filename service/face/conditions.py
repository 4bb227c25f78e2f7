"""What about a face in a photo makes its fit less certain: too dark, eyes covered."""

from __future__ import annotations

import cv2
import numpy as np

from service.arrays import Float64, UInt8

Pixels = UInt8

EYES = (
    (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7),
    (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249),
)
"""Outlines of the image-left and image-right eye."""
CHEEKS = ((116, 117, 118, 101, 205, 187, 147, 123), (345, 346, 347, 330, 425, 411, 376, 352))
OVAL = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip

DARK = 0.05
"""Linear luminance that three quarters of an under-exposed face stay below (dark skin in good light: 0.15)."""
EYE_GROWTH = 1.6
"""Eye outlines are enlarged by this much, so that lids and lashes are inside."""
COVERED_LEVEL, COVERED_CONTRAST = 0.35, 0.4
"""Of a covered eye three quarters are darker than this part of the cheek, and half lie in this range over the mean.

Seventeen photos, hard shadow among them, have 0.55 to 1.8 there; glints do not count, as they are in a quarter."""


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
    """Whether an eye is much darker than its cheek and has no contrast of its own; False where one is out of view."""
    centre = eye.mean(0)
    inside, skin = _luminance(pixels, centre + (eye - centre) * EYE_GROWTH), _luminance(pixels, cheek)
    if not inside.size or not skin.size:
        return False
    low, high = (float(v) for v in np.percentile(inside, (25, 75)))
    return high < COVERED_LEVEL * float(np.median(skin)) and high - low <= COVERED_CONTRAST * float(inside.mean())


def _luminance(pixels: Pixels, polygon: Float64) -> Float64:
    """Linear luminances in [0, 1] of the photo inside an (N, 2) polygon; empty where none of it lies in the photo."""
    height, width = pixels.shape[:2]
    x0, y0 = np.clip(np.floor(polygon.min(0)), 0, [width, height]).astype(int)
    x1, y1 = np.clip(np.ceil(polygon.max(0)), 0, [width, height]).astype(int)
    if x1 <= x0 or y1 <= y0:
        return np.zeros(0)
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    corners = np.round(polygon - [x0, y0] - 0.5).astype(np.int32)  # OpenCV puts pixel centres at integers
    cv2.fillPoly(mask, [corners], [1])
    encoded = pixels[y0:y1, x0:x1][mask > 0].astype(np.float64) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ [0.2126, 0.7152, 0.0722])
