"""Colours of iris and sclera: those of people in general, and as measured in the photo between the lids.

Albedos are diffuse, linear RGB in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import Float32, UInt8
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.face.features.iris import MARGIN, Iris
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


BELOW = 1.2
"""Distance from the lid opening to the skin below it, in opening heights."""

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

MOST_MIRRORED = 0.7
"""Largest share of an iris's light that counts as mirrored by the cornea, so that the darkest iris keeps a colour."""

LIKE_SKIN = 0.35
"""What is measured as an iris is a lid from this likeness to the skin below the eye on: its luminance over the skin's,
times the square of its red over blue over the skin's. Irises of photos have 0.01 to 0.2, blue ones beside dark skin
too; lids 0.45 and more."""


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
    down = np.array([0.0, BELOW * float(np.ptp(iris.rim[:, 1]))])
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
    return np.asarray(shown - np.minimum(mirrored, np.float32(MOST_MIRRORED) * shown), np.float32)


def _is_lid(shown: Float32, skin: Float32) -> bool:
    """Whether a linear colour (3,) is too similar to that of the skin (3,) below the eye to be an iris."""
    brightness = float(luma(shown)) / max(float(luma(skin)), 1e-6)
    redness = [float(c[0] + 1e-4) / float(c[2] + 1e-4) for c in (shown, skin)]
    return brightness * (redness[0] / redness[1]) ** 2 > LIKE_SKIN


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
