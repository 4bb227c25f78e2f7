"""Colours of iris and sclera as measured between the lids, and the photo's light, measured on sclera and teeth.

Albedos are diffuse, linear RGB in [0, 1].

Skin alone cannot tell dark skin from dim light, nor brown skin from a warm lamp. Sclera and teeth are close to white in
everybody: the sclera has a reflectance of 0.55 to 0.7, nearly grey, so its colour in the photo gives the colour and
strength of the light there, apart from the shade of the lids. Whatever is mistaken for them (lids, lips, lashes, shadow
in the mouth) is redder, and so is sclera that is lit by the skin around it alone, on the side away from a lamp. So the
hue is taken from the least red measurements, and the strength from all that are not lids.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import LUMA, linear_to_srgb, luma, srgb_to_linear
from service.face.features.eyes import Gaze
from service.face.features.iris import MARGIN, Iris
from service.face.features.mouth import teeth_light
from service.face.features.rims import inside_rim

SCLERA = np.array([0.63, 0.59, 0.56], np.float32)
"""Sclera: nearly grey and much the same in everybody; its blood vessels make it slightly red."""

IRIS = np.array([0.099, 0.054, 0.029454546], np.float32)
"""Iris assumed where the photo does not show its colour: medium brown, the most frequent."""

NAMED_IRISES = {
    name: np.array(albedo, np.float32)
    for name, albedo in {
        "dark_brown": (0.040, 0.022, 0.012), "brown": (0.099, 0.054, 0.029), "hazel": (0.130, 0.085, 0.040),
        "green": (0.100, 0.115, 0.065), "blue": (0.085, 0.120, 0.165), "grey": (0.130, 0.145, 0.155),
    }.items()
}  # fmt: skip
"""Irises that a caller names, linear RGB; within what :func:`likely_iris` takes for possible."""

MOST_IRIS_LUMA, MOST_IRIS_CHANNEL = 0.2, 0.32
"""Largest luminance of an iris, and its largest channel. Without these limits an iris would glow where the sclera,
which tells the light, lies in the lids' shade, or where skin was mistaken for an iris."""

DARKEST_IRIS = np.array([0.020, 0.014, 0.010], np.float32)
"""Lower limit of each channel of an iris."""

MOST_RED, LEAST_BLUE = 2.5, 0.4
"""Red over green and blue over green of the brownest iris."""


def likely_iris(albedo: Float32) -> Float32:
    """(3,) a measured albedo (3,) >= 0, limited to what irises have: brightness, and neither purple nor red.

    Brown, green, blue and grey irises have at least as much green as the geometric mean of red and blue. A purple
    measurement is a brown iris that mirrors the sky; a red one is a brown iris in the light of a lamp or a flash.
    """
    red, green, blue = np.maximum(albedo, np.float32(1e-4))
    linear = np.array([red, green, min(blue, green * green / red)], np.float32)
    if red > MOST_RED * green:
        brown = np.array([MOST_RED, 1.0, max(linear[2] / green, LEAST_BLUE)], np.float32)
        linear = brown * np.float32(luma(linear) / luma(brown))
    excess = max(1.0, float(luma(linear)) / MOST_IRIS_LUMA, float(linear.max()) / MOST_IRIS_CHANNEL)
    return np.asarray(np.maximum(linear / np.float32(excess), DARKEST_IRIS), np.float32)


COLOURLESS = 0.012
"""Range of the channels of an sRGB colour below which it has no hue: three codes of 255."""


def colourless(shown: Float32) -> bool:
    """Whether an sRGB colour (3,) in [0, 1] has no hue, as all of a photo without colour."""
    return float(shown.max() - shown.min()) < COLOURLESS


def iris_without_light(shown: Float32, white: Float32) -> Float32:
    """(3,) linear albedo of irises of sRGB colour (3,) in light in which white is linear RGB (3,).

    A photo without colour shows how dark they are and not their hue: they are brown, as most are.
    """
    albedo = np.asarray(srgb_to_linear(shown) / white, np.float32)
    if colourless(shown):
        albedo = IRIS * np.float32(luma(albedo) / luma(IRIS))
    return likely_iris(albedo)


LEAST_SAMPLES = 12
"""Fewest pixels from which a colour is measured."""

IRIS_RING, SCLERA_FROM, PUPIL_TO = (0.5, 0.88), 1.2, 0.28
"""In iris radii: the ring in which the iris is measured, outside wide pupils too; the distance from which on pixels are
sclera; and that up to which they are pupil."""

SHARP, BLURRED = (0.4, 0.8), (0.2, 0.55)
"""Quantiles of an iris's luma between which pixels are averaged, where the photo resolves it and where it does not.
Darker pixels lie in the lid's shadow, brighter ones mirror lamps; blur mixes sclera and lamps into more of the bright
ones."""

RESOLVED = (6.0, 10.0)
"""Radius of an iris in pixels from which on the photo begins to resolve its pupil, and resolves it fully."""


def eye_colours(pixels: UInt8, irises: Sequence[Iris]) -> tuple[Float32 | None, Float32 | None]:
    """(3,) sRGB of the sclera and of the irises of both eyes in a photo (H, W, 3) uint8 sRGB.

    Each is None where too little of it is seen. Light that the cornea mirrors is subtracted from the irises'.
    """
    scleras, found_irises = [np.zeros((0, 3), np.float32)], []
    for iris in irises:
        colour, at = inside_rim(pixels, iris.rim, MARGIN * iris.radius)
        distance = np.linalg.norm(at - iris.centre, axis=1) / iris.radius
        scleras.append(colour[distance > SCLERA_FROM])
        found = _iris(colour, distance, iris.radius, skin_below(pixels, iris))
        found_irises += [] if found is None else [found]
    return _sclera(np.concatenate(scleras)), linear_to_srgb(np.mean(found_irises, 0)) if found_irises else None


def skin_below(pixels: UInt8, iris: Iris) -> Float32:
    """(n, 3) sRGB below the eye."""
    # Distance from the lid opening to the skin below it, in opening heights.
    down = np.array([0.0, 1.2 * float(np.ptp(iris.rim[:, 1]))])
    return inside_rim(pixels, iris.rim + down, 0.0)[0]


def _iris(colour: Float32, distance: Float32, radius: float, skin: Float32) -> Float32 | None:
    """(3,) linear colour of one iris; None where too little of it is seen, or a lid instead.

    Args:
        colour: (n, 3) sRGB between the lids.
        distance: (n,) from the iris's centre, in its radii.
        radius: of the iris in pixels.
        skin: (m, 3) sRGB below the eye.
    """
    ring = srgb_to_linear(colour[(distance > IRIS_RING[0]) & (distance < IRIS_RING[1])])
    if len(ring) < LEAST_SAMPLES:
        return None
    ring = ring[np.argsort(luma(ring), kind="stable")]
    sharpness = _resolved(radius)
    low, high = (
        int((blur + sharpness * (sharp - blur)) * len(ring)) for sharp, blur in zip(SHARP, BLURRED, strict=True)
    )
    shown = np.asarray(ring[low : max(high, low + 1)].mean(0), np.float32)
    if len(skin) >= LEAST_SAMPLES and _is_lid(shown, np.median(srgb_to_linear(skin), axis=0)):
        return None
    mirrored = np.float32(_mirrored(colour[distance < PUPIL_TO], radius))
    # Largest share of an iris's light that counts as mirrored by the cornea, so that the darkest iris keeps a colour.
    return np.asarray(shown - np.minimum(mirrored, np.float32(0.7) * shown), np.float32)


def _is_lid(shown: Float32, skin: Float32) -> bool:
    """Whether a linear colour (3,) is too similar to that of the skin (3,) below the eye to be an iris."""
    brightness = float(luma(shown)) / max(float(luma(skin)), 1e-6)
    redness = [float(c[0] + 1e-4) / float(c[2] + 1e-4) for c in (shown, skin)]
    # What is measured as an iris is a lid from this likeness to the skin below the eye on: its luminance over the
    # skin's, times the square of its red over blue over the skin's. Irises of photos have 0.01 to 0.2, blue ones beside
    # dark skin too; lids 0.45 and more.
    return brightness * (redness[0] / redness[1]) ** 2 > 0.35


def _mirrored(pupil: Float32, radius: float) -> float:
    """Linear grey light that the cornea mirrors all over the iris: what is seen of the pupil, which is black.

    It is the mean of the darker half of the pupil's pixels (n, 3) sRGB, as lamps are mirrored in few places, in the
    darkest channel, as flashes colour pupils; and less where the photo does not resolve the pupil.
    """
    if not len(pupil):
        return 0.0
    linear = srgb_to_linear(pupil)
    linear = linear[np.argsort(luma(linear), kind="stable")][: max(len(linear) // 2, 1)]
    return _resolved(radius) * float(linear.mean(0).min())


def _resolved(radius: float) -> float:
    """How well an iris of a radius in pixels is resolved, in [0, 1]."""
    return float(np.clip((radius - RESOLVED[0]) / (RESOLVED[1] - RESOLVED[0]), 0, 1))


def _sclera(colours: Float32) -> Float32 | None:
    """(3,) sRGB of the sclera among colours (n, 3) beside the iris; None where the result is dark or colourful.

    The mean from the 70th to the 95th percentile of blue: lids, lashes and shadow have less, mirrored lamps more.
    """
    if len(colours) < LEAST_SAMPLES:
        return None
    order = np.argsort(colours[:, 2], kind="stable")
    low, high = (7 * len(order)) // 10, (19 * len(order)) // 20
    bright = colours[order[low : max(high, low + 1)]].mean(0)
    saturation = float(bright.max() - bright.min()) / max(float(bright.max()), 1e-3)
    return bright.astype(np.float32) if saturation < 0.4 and bright.max() > 0.2 else None


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

LEAST_BLUE_OF_SCLERA, CLEARLY_BLUE = 1.3, 1.5
"""Blue over red of the sclera, divided by that of the skin below the eye, which cancels the colour of the light: below
the first it is taken for skin or shade, from the second on it is surely sclera. By their reflectances it is 1.4 beside
the fairest skin and 2 or more beside dark skin; on rendered heads 1.5 to 2.5."""

LEAST_BLUE_OF_BRIGHT, BRIGHT = 1.15, 1.2
"""The lower limit instead of ``LEAST_BLUE_OF_SCLERA`` where the sclera's luminance is at least ``BRIGHT`` times that of
the skin below: that skin may lie in other light."""

FAIREST = 1.1
"""Largest linear reflectance of the skin below the eye that the light may imply: the fairest has 0.65 in red, and the
sclera gives the light up to a factor of 1.6. A sclera that implies more lies in deeper shade; its light is raised."""

MOST_RAISED = 1.6
"""Largest factor by which it is raised; where more is missing, lashes and shadow are seen instead of the sclera."""

OVEREXPOSED = 1.0 - LIT[0]
"""Share of the sclera's pixels that are overexposed from which all of its best lit part is, and no glint."""


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
    # 8-bit code from which on a pixel may be overexposed.
    kept = np.asarray((colours < 250 / 255).all(1))
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
    least = LEAST_BLUE_OF_BRIGHT if brightness >= BRIGHT else LEAST_BLUE_OF_SCLERA
    # Largest linear reflectance of the skin below the eye that the light of a sclera may imply which is less than
    # ``CLEARLY_BLUE``.
    if blue < least or (blue < CLEARLY_BLUE and implied > 0.85) or implied > FAIREST * MOST_RAISED:
        return None
    return light * (max(1.0, implied / FAIREST) * BETWEEN_LIDS / BEST_LIT)


def _blue_over_red(linear: AnyFloat) -> Float64:
    """(N,) blue over red of linear RGB (N, 3)."""
    return np.asarray((linear[:, 2] + 1e-4) / (linear[:, 0] + 1e-4), np.float64)


CHEEKS = (50, 280)
"""Landmarks in the middle of the cheeks."""
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
    # Radius of the sample on each cheek, over the inter-ocular distance.
    radius, found = 0.12 * inter_ocular_px, []
    for x, y in np.asarray(landmarks, np.float64)[list(CHEEKS), :2]:
        if not np.isfinite([x, y, radius]).all():
            continue
        left, top = (max(int(v - radius), 0) for v in (x, y))
        right, bottom = (min(int(np.ceil(v + radius)), most) for v, most in ((x, width), (y, height)))
        found.append(pixels[top : max(bottom, top), left : max(right, left)].reshape(-1, 3))
    colours = np.concatenate(found) if found else np.zeros((0, 3))
    return np.asarray(np.median(colours, 0) / 255, np.float32) if len(colours) else None
