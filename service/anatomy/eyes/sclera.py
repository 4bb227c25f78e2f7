"""Light of the photo, measured on the sclera.

The sclera is much the same in everybody (reflectance 0.55 to 0.7, nearly grey), so its colour in the photo gives the
colour and strength of the light there, apart from the shade of the lids.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.eyes.colours import SCLERA
from service.anatomy.eyes.iris import Iris, filled
from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import luma, srgb_to_linear

BETWEEN_LIDS = 0.67
"""Light on the sclera, averaged over all that is seen of it, as a share of the light on the lids."""

BEYOND = 1.15
"""Distance from the iris's centre, in iris radii, from which on pixels are surely sclera: the limbus is soft."""

LEAST_RADIUS, LEAST_PIXELS = 3.0, 12
"""Smallest radius of an iris in pixels, and fewest pixels of sclera: with less, blur mixes in lids and lashes."""

LIT = (0.8, 0.97)
"""Quantiles of blue between which pixels of the sclera are averaged. Whatever else is seen between the lids (their
rims, lashes, shade, the iris) has less blue, and the brightest pixels are glints."""

BEST_LIT = 0.92
"""Light on that best lit part of the sclera, as a share of the light on the lids, of rendered heads."""

LEAST_BLUE, CLEARLY_BLUE = 1.3, 1.5
"""Blue over red of the sclera, divided by that of the skin below the eye, which cancels the colour of the light: below
the first it is taken for skin or shade, from the second on it is surely sclera. By their reflectances it is 1.4 beside
the fairest skin and 2 or more beside dark skin; on rendered heads 1.5 to 2.5."""

LEAST_BLUE_OF_BRIGHT, BRIGHT = 1.15, 1.2
"""The lower limit instead of ``LEAST_BLUE`` where the sclera's luminance is at least ``BRIGHT`` times that of the skin
below: that skin may lie in other light."""

LIKELY_SKIN = 0.85
"""Largest linear reflectance of the skin below the eye that the light of a sclera may imply which is less than
``CLEARLY_BLUE``."""

BELOW = 1.2
"""Distance from the lid opening to the skin below it, in opening heights."""

FAIREST = 1.1
"""Largest linear reflectance of the skin below the eye that the light may imply: the fairest has 0.65 in red, and the
sclera gives the light up to a factor of 1.6. A sclera that implies more lies in deeper shade; its light is raised."""

MOST_RAISED = 1.6
"""Largest factor by which it is raised; where more is missing, lashes and shadow are seen instead of the sclera."""

MARGIN = 0.12
"""Distance in iris radii that pixels keep from the rim of the lids."""

CLIPPED = 250
"""8-bit code from which on a pixel may be overexposed."""

OVEREXPOSED = 1.0 - LIT[0]
"""Share of the sclera's pixels that are overexposed from which all of its best lit part is, and no glint."""

BRIGHTEST_TOLD = float(BETWEEN_LIDS / BEST_LIT / SCLERA.mean())
"""Mean light that a sclera tells which is just overexposed: it may be any more."""


def sclera_light(pixels: UInt8, iris: Iris) -> Float64 | None:
    """Light on the sclera of one eye.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        iris: with the rim of the lid opening.

    Returns:
        (3,) linear RGB radiance, finite and positive, that a white diffuse surface would have in place of the sclera,
        averaged over it; it is measured on the best lit part and scaled to the mean. Where that part is overexposed, as
        it is in a photo metered on dark skin, the least light that does that, in the hue of the rest. None where the
        sclera is not seen well: the eye is closed or small, or all of it is overexposed.
    """
    colours, at = inside_rim(pixels, iris.rim, MARGIN * iris.radius)
    outside = np.linalg.norm(at - iris.centre, axis=1) > BEYOND * iris.radius
    kept = np.asarray((colours < CLIPPED / 255).all(1))
    overexposed = bool(outside.any()) and float(np.mean(~kept[outside])) >= OVEREXPOSED
    colours = colours[outside & kept]
    below = np.array([0.0, BELOW * float(np.ptp(iris.rim[:, 1]))])
    skin, _ = inside_rim(pixels, iris.rim + below, 0.0)
    if iris.radius < LEAST_RADIUS or len(colours) < LEAST_PIXELS or len(skin) < LEAST_PIXELS:
        return None
    linear = srgb_to_linear(colours).astype(np.float64)
    low, high = np.quantile(linear[:, 2], LIT)
    sclera = linear[(linear[:, 2] >= low) & (linear[:, 2] <= high)].mean(0)
    typical = np.median(srgb_to_linear(skin), axis=0)
    if not (sclera > 0).all():
        return None
    if overexposed:
        sclera = sclera * max(1.0, 1.0 / float(sclera.mean()))
    light = np.asarray(sclera / SCLERA.astype(np.float64))
    blue = _blue_over_red(sclera[None])[0] / _blue_over_red(typical[None])[0]
    implied = float((typical * BEST_LIT / light).max())
    brightness = float(luma(sclera) / max(float(luma(typical)), 1e-6))
    least = LEAST_BLUE_OF_BRIGHT if brightness >= BRIGHT else LEAST_BLUE
    if blue < least or (blue < CLEARLY_BLUE and implied > LIKELY_SKIN) or implied > FAIREST * MOST_RAISED:
        return None
    return light * (max(1.0, implied / FAIREST) * BETWEEN_LIDS / BEST_LIT)


def inside_rim(pixels: UInt8, rim: AnyFloat, margin: float) -> tuple[Float32, Float64]:
    """Colours (n, 3) sRGB and centres (n, 2) of the pixels inside a rim (N, 2) and over ``margin`` pixels from it."""
    import cv2

    size = np.array(pixels.shape[1::-1])
    if not np.isfinite(rim).all():
        return np.zeros((0, 3), np.float32), np.zeros((0, 2))
    low = np.clip(np.floor(rim.min(0)).astype(int) - 1, 0, size - 1)
    high = np.clip(np.ceil(rim.max(0)).astype(int) + 2, low + 1, size)
    width, height = (high - low + 2).tolist()
    mask = filled(rim - low + 0.5, (height, width))
    deep = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 3))[1:-1, 1:-1] > max(margin, 0.5)
    rows, columns = np.nonzero(deep)
    colour = pixels[low[1] : high[1], low[0] : high[0]][rows, columns].astype(np.float32) / np.float32(255)
    return colour, np.stack([columns, rows], 1) + low + 0.5


def _blue_over_red(linear: AnyFloat) -> Float64:
    """(N,) blue over red of linear RGB (N, 3)."""
    return np.asarray((linear[:, 2] + 1e-4) / (linear[:, 0] + 1e-4), np.float64)
