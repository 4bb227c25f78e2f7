"""What the whites of the eyes tell of the light.

Whether skin is dark or dimly lit, a photo of skin alone cannot say. The white of the eye is much the same in everybody
(reflectance 0.55 to 0.7, nearly grey), so its colour in the photo is the colour and strength of the light there, but
for the shade of the lids.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import bytes_to_linear, luma
from service.fit.gaze import Gaze, Iris

Array = npt.NDArray[np.float64]

ALBEDO = np.array([0.63, 0.59, 0.56])
"""Reflectance of the sclera, linear RGB: a little redder than grey for its vessels."""
BEYOND = 1.22
"""Radii of the iris at which the white begins for certain; the limbus is soft."""
LEAST_PIXELS = 12
"""Whites with fewer pixels are blurred into lids and lashes."""
BRIGHT = (0.5, 0.9)
"""Quantiles of luminance between which pixels are taken: below are lashes, lids and shade, above are glints."""
CLIPPED = 250
"""Codes from which a pixel may be overexposed."""
RANGE = (1e-3, 4.0)
"""Light outside it is not to be measured in 8 bits."""


def eye_white_light(pixels: npt.NDArray[np.uint8], gaze: Gaze | None) -> Array | None:
    """Light on the whites of the eyes, from the photo.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        gaze: with the irises that were found.

    Returns:
        (3,) linear RGB radiance that a white diffuse surface would have in place of the sclera, finite and positive;
        the geometric mean of both eyes. None where no white is seen well: eyes closed, small, or overexposed.
    """
    seen = [white for iris in (gaze.irises if gaze else ()) if (white := _white(pixels, iris)) is not None]
    if not seen:
        return None
    light = np.exp(np.mean(np.log(np.stack(seen)), 0))
    return np.asarray(np.clip(light, *RANGE), np.float64)


def _white(pixels: npt.NDArray[np.uint8], iris: Iris) -> Array | None:
    """Light by one eye; None where too little of its white is seen."""
    import cv2

    low = np.maximum(np.floor(iris.rim.min(0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(iris.rim.max(0)).astype(int) + 2, pixels.shape[1::-1])
    if (high - low < 3).any():
        return None
    part = pixels[low[1] : high[1], low[0] : high[0]]
    inside = np.zeros(part.shape[:2], np.uint8)
    cv2.fillPoly(inside, [np.rint((iris.rim - low - 0.5) * 16).astype(np.int32)], 1, shift=4)
    margin = max(round(0.15 * iris.radius), 1)
    inside = np.asarray(cv2.erode(np.pad(inside, 1), np.ones((2 * margin + 1, 1), np.uint8))[1:-1, 1:-1], np.uint8)
    y, x = np.indices(inside.shape) + 0.5
    away = np.hypot(x + low[0] - iris.centre[0], y + low[1] - iris.centre[1]) > BEYOND * iris.radius
    colours = part[(inside > 0) & away]
    colours = colours[(colours < CLIPPED).all(1)]
    if len(colours) < LEAST_PIXELS:
        return None
    linear = bytes_to_linear(colours).astype(np.float64)
    luminance = luma(linear)
    bottom, top = np.quantile(luminance, BRIGHT)
    chosen = linear[(luminance >= bottom) & (luminance <= top)]
    white = chosen.mean(0) / ALBEDO
    return np.asarray(white) if len(chosen) and (white > 0).all() else None
