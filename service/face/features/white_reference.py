"""White reference: the light of the photo, measured on sclera and teeth.

Skin alone cannot tell dark skin from dim light, nor brown skin from a warm lamp. Sclera and teeth are close to white in
everybody: the sclera has a reflectance of 0.55 to 0.7, nearly grey, so its colour in the photo gives the colour and
strength of the light there, apart from the shade of the lids. Whatever is mistaken for them (lids, lips, lashes, shadow
in the mouth) is redder, and so is sclera that is lit by the skin around it alone, on the side away from a lamp. So the
hue is taken from the least red measurements, and the strength from all that are not lids.
"""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import LUMA, luma, srgb_to_linear
from service.face.features.eye_colours import SCLERA, skin_below
from service.face.features.eyes import Gaze
from service.face.features.iris import MARGIN, Iris
from service.face.features.rims import inside_rim
from service.face.features.teeth import teeth_light

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

FAIREST = 1.1
"""Largest linear reflectance of the skin below the eye that the light may imply: the fairest has 0.65 in red, and the
sclera gives the light up to a factor of 1.6. A sclera that implies more lies in deeper shade; its light is raised."""

MOST_RAISED = 1.6
"""Largest factor by which it is raised; where more is missing, lashes and shadow are seen instead of the sclera."""

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
    skin = skin_below(pixels, iris)
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


def _blue_over_red(linear: AnyFloat) -> Float64:
    """(N,) blue over red of linear RGB (N, 3)."""
    return np.asarray((linear[:, 2] + 1e-4) / (linear[:, 0] + 1e-4), np.float64)


CHEEKS = (50, 280)
"""Landmarks in the middle of the cheeks."""
CHEEK_RADIUS = 0.12
"""Radius of the sample on each cheek, over the inter-ocular distance."""
REDDER, SAME_HUE = 2.0, 1.3
"""Factors by which the ratio of blue to red may be below that of the least red measurement: to be sclera or tooth at
all (1.5 in the shade of a lamp from one side; lids have 1.4 to 2.5), and to contribute to the hue."""
RANGE = (1e-3, 4.0)
"""Range of linear radiance that an 8-bit photo can measure; results are clipped to it."""


def light_from_sclera_and_teeth(
    pixels: UInt8,
    gaze: Gaze | None,
    tooth: Float32 | None,
    skin: Float32 | None,
) -> Float64 | None:
    """Light between the lids, measured on the sclera and on the front teeth, which receive more of it.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        gaze: with the detected irises.
        tooth: (3,) sRGB of the teeth; None where the photo shows none.
        skin: (3,) sRGB of the cheeks; None where the photo does not show them.

    Returns:
        (3,) linear RGB radiance of a white diffuse surface in place of the sclera, finite and positive: the geometric
        mean of the measurements in strength, the least red ones in hue. None where neither can be measured.
    """
    seen = [light for iris in (gaze.irises if gaze else ()) if (light := sclera_light(pixels, iris)) is not None]
    teeth = None if skin is None or tooth is None else teeth_light(tooth, skin)
    if teeth is not None:
        seen.append(teeth * BETWEEN_LIDS)
    return palest(np.stack(seen)) if seen else None


def palest(lights: Float64) -> Float64:
    """(3,) light from (N, 3) positive measurements, N > 0: strength of their geometric mean, hue of the least red."""
    pale = lights[:, 2] / lights[:, 0]
    logs = np.log(lights)
    hue, all_ = (logs[pale * redder >= pale.max()].mean(0) for redder in (SAME_HUE, REDDER))
    return np.asarray(np.clip(np.exp(hue) * (np.exp(all_) @ LUMA) / (np.exp(hue) @ LUMA), *RANGE), np.float64)


def cheek_colour(pixels: UInt8, landmarks: AnyFloat, inter_ocular_px: float) -> Float32 | None:
    """(3,) median sRGB colour in [0, 1] of the cheeks; None where the photo shows neither."""
    height, width = pixels.shape[:2]
    radius, found = CHEEK_RADIUS * inter_ocular_px, []
    for x, y in np.asarray(landmarks, np.float64)[list(CHEEKS), :2]:
        if not np.isfinite([x, y, radius]).all():
            continue
        left, top = (max(int(v - radius), 0) for v in (x, y))
        right, bottom = (min(int(np.ceil(v + radius)), most) for v, most in ((x, width), (y, height)))
        found.append(pixels[top : max(bottom, top), left : max(right, left)].reshape(-1, 3))
    colours = np.concatenate(found) if found else np.zeros((0, 3))
    return np.asarray(np.median(colours, 0) / 255, np.float32) if len(colours) else None
