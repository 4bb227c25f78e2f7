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
BRIGHT = (0.4, 0.92)
"""Quantiles of luminance between which pixels are taken: below are lashes and shade, above are glints."""
PALE = 0.6
"""Quantile of blue over red from which pixels are taken: the rest may be lid, since rims are found to some pixels."""
PALER = 1.6
"""Times by which the white is less red than the skin below the eye, under whatever light; skin it is else."""
BELOW = 1.4
"""Radii of the iris by which the skin below lies below."""
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

    down = (0.0, BELOW * iris.radius)
    low = np.maximum(np.floor(iris.rim.min(0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil((iris.rim + down).max(0)).astype(int) + 2, pixels.shape[1::-1])
    if (high - low < 3).any():
        return None
    part = pixels[low[1] : high[1], low[0] : high[0]]
    inside, below = np.zeros(part.shape[:2], np.uint8), np.zeros(part.shape[:2], np.uint8)
    for mask, rim in ((inside, iris.rim), (below, iris.rim + down)):
        cv2.fillPoly(mask, [np.rint((rim - low - 0.5) * 16).astype(np.int32)], 1, shift=4)
    margin = max(round(0.15 * iris.radius), 1)
    column = np.ones((2 * margin + 1, 1), np.uint8)
    skin = part[(below > 0) & (cv2.dilate(inside, column) == 0)]
    inside = np.asarray(cv2.erode(np.pad(inside, 1), column)[1:-1, 1:-1], np.uint8)
    y, x = np.indices(inside.shape) + 0.5
    away = np.hypot(x + low[0] - iris.centre[0], y + low[1] - iris.centre[1]) > BEYOND * iris.radius
    colours = part[(inside > 0) & away]
    colours = colours[(colours < CLIPPED).all(1)]
    if len(colours) < LEAST_PIXELS or len(skin) < LEAST_PIXELS:
        return None
    linear = bytes_to_linear(colours).astype(np.float64)
    luminance, pale = luma(linear), _blue_over_red(linear)
    bottom, top = np.quantile(luminance, BRIGHT)
    chosen = linear[(luminance >= bottom) & (luminance <= top) & (pale >= np.quantile(pale, PALE))]
    if not len(chosen):
        return None
    usual = _blue_over_red(np.median(bytes_to_linear(skin), axis=0)[None])[0]
    white = chosen.mean(0)
    if _blue_over_red(white[None])[0] < PALER * usual or not (white > 0).all():
        return None
    return np.asarray(white / ALBEDO)


def _blue_over_red(linear: npt.NDArray[np.floating]) -> Array:
    """(N,) of linear (N, 3)."""
    return np.asarray((linear[:, 2] + 1e-4) / (linear[:, 0] + 1e-4), np.float64)
