"""What the white of an eye tells of the light.

The white of the eye is much the same in everybody (reflectance 0.55 to 0.7, nearly grey), so its colour in the photo is
the colour and strength of the light there, but for the shade of the lids.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.colours import SCLERA
from service.anatomy.eyes.iris import Iris
from service.colour import luma, srgb_to_linear

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

BETWEEN_LIDS = 0.67
"""Share of the light on the lids that is left between them, on the whole of the white."""
BEYOND = 1.15
"""Radii of the iris at which the white begins for certain; the limbus is soft."""
LEAST_RADIUS, LEAST_PIXELS = 3.0, 12
"""Pixels; whites of smaller irises, or with fewer pixels, are blurred into lids and lashes."""
LIT = (0.8, 0.97)
"""Quantiles of blue between which pixels are taken. Whatever else is seen between the lids (their rims, lashes, shade,
the iris) has less blue than the white has, and the brightest are glints."""
IN_THE_OPEN = 0.92
"""Share of the light on the lids that this best lit part of the white stands in; ``benchmarks.eye_whites``."""
PALER, CLEARLY = 1.3, 1.5
"""Times by which the white is less red than the skin below the eye, under whatever light; else it is taken for skin or
shade. By their reflectances it is 1.4 beside the fairest skin, 2 and more beside dark. Rendered heads: 1.5 to 2.5."""
PALER_AND_BRIGHTER = (1.15, 1.2)
"""As much less red, and as much brighter than the skin below, it is a white too: that skin may lie in other light."""
LIKELY = 0.85
"""Largest linear reflectance of the skin below that a white gives that is not ``CLEARLY`` less red."""
BELOW = 1.2
"""Heights of the opening by which the skin below lies below."""
FAIREST = 1.1
"""Largest linear reflectance of the skin below: the fairest has 0.65 in red, and the white tells the light up to
a factor of 1.6. A white that makes skin paler than that lies in deeper shade, and counts as so much brighter."""
TOO_DEEP = 1.6
"""Times by which it may; where more is missing, no white is seen but lashes and shadow."""
MARGIN = 0.12
"""Radii of the iris by which pixels have to lie inside the rim."""
CLIPPED = 250
"""Codes from which a pixel may be overexposed."""


def sclera_light(pixels: npt.NDArray[np.uint8], iris: Iris) -> Array | None:
    """Light on the white of one eye, from the photo.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        iris: with the rim of the opening round it.

    Returns:
        (3,) linear RGB radiance, finite and positive, that a white diffuse surface would have in place of the sclera,
        on its mean: its best lit part tells the light best, and stands in more of it. None where none is seen well:
        the eye is closed, small or overexposed.
    """
    colours, at = inside_rim(pixels, iris.rim, MARGIN * iris.radius)
    beside = np.linalg.norm(at - iris.centre, axis=1) > BEYOND * iris.radius
    colours = colours[beside & (colours < CLIPPED / 255).all(1)]
    below = np.array([0.0, BELOW * float(np.ptp(iris.rim[:, 1]))])
    skin, _ = inside_rim(pixels, iris.rim + below, 0.0)
    if iris.radius < LEAST_RADIUS or len(colours) < LEAST_PIXELS or len(skin) < LEAST_PIXELS:
        return None
    linear = srgb_to_linear(colours).astype(np.float64)
    low, high = np.quantile(linear[:, 2], LIT)
    white = linear[(linear[:, 2] >= low) & (linear[:, 2] <= high)].mean(0)
    usual = np.median(srgb_to_linear(skin), axis=0)
    if not (white > 0).all():
        return None
    light = np.asarray(white / SCLERA.astype(np.float64))
    paler = _blue_over_red(white[None])[0] / _blue_over_red(usual[None])[0]
    implied = float((usual * IN_THE_OPEN / light).max())
    brighter = float(luma(white) / max(float(luma(usual)), 1e-6))
    least = PALER_AND_BRIGHTER[0] if brighter >= PALER_AND_BRIGHTER[1] else PALER
    if paler < least or (paler < CLEARLY and implied > LIKELY) or implied > FAIREST * TOO_DEEP:
        return None
    return light * (max(1.0, implied / FAIREST) * BETWEEN_LIDS / IN_THE_OPEN)


def inside_rim(pixels: npt.NDArray[np.uint8], rim: npt.NDArray[np.floating], margin: float) -> tuple[Float, Array]:
    """Colours (n, 3) in [0, 1] and centres (n, 2) of the pixels inside a rim (N, 2), ``margin`` pixels away from it."""
    import cv2

    size = np.array(pixels.shape[1::-1])
    if not np.isfinite(rim).all():
        return np.zeros((0, 3), np.float32), np.zeros((0, 2))
    low = np.clip(np.floor(rim.min(0)).astype(int) - 1, 0, size - 1)
    high = np.clip(np.ceil(rim.max(0)).astype(int) + 2, low + 1, size)
    mask = np.zeros((high - low + 2)[::-1], np.uint8)
    cv2.fillPoly(mask, [np.rint((rim - low + 0.5) * 16).astype(np.int32)], 1, shift=4)
    deep = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 3))[1:-1, 1:-1] > max(margin, 0.5)
    rows, columns = np.nonzero(deep)
    colour = pixels[low[1] : high[1], low[0] : high[0]][rows, columns].astype(np.float32) / np.float32(255)
    return colour, np.stack([columns, rows], 1) + low + 0.5


def _blue_over_red(linear: npt.NDArray[np.floating]) -> Array:
    """(N,) of linear (N, 3)."""
    return np.asarray((linear[:, 2] + 1e-4) / (linear[:, 0] + 1e-4), np.float64)
