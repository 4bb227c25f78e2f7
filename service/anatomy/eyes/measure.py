"""Colours of iris and white as the photo shows them between the lids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.iris import Iris
from service.anatomy.eyes.sclera import BELOW, inside_rim
from service.colour import linear_to_srgb, luma, srgb_to_linear

Float = npt.NDArray[np.float32]

LEAST_SAMPLES = 12
RIM = 0.12
"""Radii of the iris by which pixels have to lie inside the rim of the lids."""
RING, WHITE, PUPIL = (0.5, 0.88), 1.2, 0.28
"""Radii of the iris between which it is measured, in the dark with wide pupils too, from which on the white is, and up
to which the pupil is."""
USUAL, BLURRED = (0.4, 0.8), (0.2, 0.55)
"""Quantiles of an iris's luma that count: what is darker lies in the lid's shadow, what is brighter mirrors lamps. Of
one that the photo does not resolve more is brighter, as the white and the lamp run into it."""
RESOLVED = (6.0, 10.0)
"""Radius of an iris, in pixels, from which on its pupil begins to be told from it, and is."""
MOST_MIRRORED = 0.7
"""Share of an iris's light that the cornea may mirror: of the darkest something has to be left."""
LIKE_SKIN = 0.35
"""Luminance beside the skin below the eye, times the square of red over blue beside its, from which on an iris is a
lid. Irises of photos have 0.01 to 0.2, blue ones beside dark skin too; lids 0.45 and more."""


@dataclass(frozen=True)
class EyeTone:
    """Colours measured on both eyes: (3,) sRGB each, None where too little of it was seen.

    The iris's is less what the cornea mirrors.
    """

    sclera: Float | None
    iris: Float | None


def measure_eyes(pixels: npt.NDArray[np.uint8], irises: Sequence[Iris]) -> EyeTone:
    """Iris and pale sclera of what (H, W, 3) uint8 sRGB shows between the lids."""
    white, dark = [np.zeros((0, 3), np.float32)], []
    for iris in irises:
        colour, at = inside_rim(pixels, iris.rim, RIM * iris.radius)
        distance = np.linalg.norm(at - iris.centre, axis=1) / iris.radius
        white.append(colour[distance > WHITE])
        found = _iris(colour, distance, iris.radius, _skin_below(pixels, iris))
        dark += [] if found is None else [found]
    own = None if not dark else linear_to_srgb(np.mean(dark, 0))
    return EyeTone(_pale(np.concatenate(white)), own)


def _skin_below(pixels: npt.NDArray[np.uint8], iris: Iris) -> Float:
    """(n, 3) sRGB below the eye."""
    down = np.array([0.0, BELOW * float(np.ptp(iris.rim[:, 1]))])
    return inside_rim(pixels, iris.rim + down, 0.0)[0]


def _iris(colour: Float, distance: Float, radius: float, skin: Float) -> Float | None:
    """(3,) linear colour of one iris; None where too little is seen, or a lid.

    Args:
        colour: (n, 3) sRGB between the lids.
        distance: (n,) from the iris's middle, in its radii.
        radius: of the iris in pixels.
        skin: (m, 3) sRGB below the eye.
    """
    ring = srgb_to_linear(colour[(distance > RING[0]) & (distance < RING[1])])
    if len(ring) < LEAST_SAMPLES:
        return None
    ring = ring[np.argsort(luma(ring), kind="stable")]
    told = _resolved(radius)
    low, high = (
        int((blurred + told * (usual - blurred)) * len(ring)) for usual, blurred in zip(USUAL, BLURRED, strict=True)
    )
    shown = np.asarray(ring[low : max(high, low + 1)].mean(0), np.float32)
    if len(skin) >= LEAST_SAMPLES and _lid(shown, np.median(srgb_to_linear(skin), axis=0)):
        return None
    mirrored = np.float32(_mirrored(colour[distance < PUPIL], radius))
    return np.asarray(shown - np.minimum(mirrored, np.float32(MOST_MIRRORED) * shown), np.float32)


def _lid(shown: Float, skin: Float) -> bool:
    """Whether a linear colour (3,) is too like that of the skin below the eye."""
    brightness = float(luma(shown)) / max(float(luma(skin)), 1e-6)
    redness = [float(c[0] + 1e-4) / float(c[2] + 1e-4) for c in (shown, skin)]
    return brightness * (redness[0] / redness[1]) ** 2 > LIKE_SKIN


def _mirrored(pupil: Float, radius: float) -> float:
    """Linear light that the cornea mirrors everywhere, taken for grey: the pupil has none of its own.

    Of the darker half of its pixels, as lamps are mirrored in few places, and of the channel that has least, as flashes
    colour pupils; less where the photo does not resolve it.
    """
    if not len(pupil):
        return 0.0
    linear = srgb_to_linear(pupil)
    linear = linear[np.argsort(luma(linear), kind="stable")][: max(len(linear) // 2, 1)]
    return _resolved(radius) * float(linear.mean(0).min())


def _resolved(radius: float) -> float:
    """How well an iris of a radius in pixels is resolved, in [0, 1]."""
    return float(np.clip((radius - RESOLVED[0]) / (RESOLVED[1] - RESOLVED[0]), 0, 1))


def _pale(colours: Float) -> Float | None:
    """Mean of what is bluest but for its top: neither lids, lashes and shadow nor mirrored lamps; None if not pale."""
    if len(colours) < LEAST_SAMPLES:
        return None
    order = np.argsort(colours[:, 2], kind="stable")
    low, high = (7 * len(order)) // 10, (19 * len(order)) // 20
    bright = colours[order[low : max(high, low + 1)]].mean(0)
    saturation = float(bright.max() - bright.min()) / max(float(bright.max()), 1e-3)
    return bright.astype(np.float32) if saturation < 0.4 and bright.max() > 0.2 else None
