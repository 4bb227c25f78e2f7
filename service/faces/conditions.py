"""What about a face in a photo makes its fit less certain: too dark, eyes covered."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.uint8]
Float = npt.NDArray[np.float64]

EYE_LEFT = (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7)
EYE_RIGHT = (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249)
CHEEKS = (50, 101, 205, 187, 280, 330, 425, 411)
OVAL = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
CROP = 128
DARK = 0.03
"""Median linear luminance of the face below which shadows are mostly noise (dark skin in good light has 0.05 or more)."""


def warnings(pixels: Pixels, landmarks: Float) -> tuple[str, ...]:
    """Stable codes for one face: ``under-exposed``.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: (468, 3) float64 photo pixels.
    """
    luminance = _sample(pixels, landmarks, OVAL)
    return ("under-exposed",) if luminance.size and float(np.median(luminance)) < DARK else ()


def _sample(pixels: Pixels, landmarks: Float, outline: tuple[int, ...]) -> Float:
    """Linear luminances of the photo pixels inside a polygon of landmarks; empty where it lies outside the photo."""
    height, width = pixels.shape[:2]
    polygon = landmarks[list(outline), :2]
    x0, y0 = np.clip(np.floor(polygon.min(0)), 0, [width, height]).astype(int)
    x1, y1 = np.clip(np.ceil(polygon.max(0)), 0, [width, height]).astype(int)
    if x1 <= x0 or y1 <= y0:
        return np.zeros(0)
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    cv2.fillPoly(mask, [np.round(polygon - [x0, y0] - 0.5).astype(np.int32)], 1)
    inside = pixels[y0:y1, x0:x1][mask > 0].astype(np.float64) / 255
    linear = np.where(inside <= 0.04045, inside / 12.92, ((inside + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ [0.2126, 0.7152, 0.0722])
