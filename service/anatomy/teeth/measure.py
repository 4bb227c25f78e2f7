"""Teeth between the lips: which pixels are teeth, their colour, and the light on them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.sclera import inside_rim
from service.anatomy.teeth.colours import TOOTH
from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import luma, srgb_to_linear

LEAST_PIXELS, LEAST_SHARE = 24, 0.08
"""Fewest pixels of teeth, and their smallest share of the opening between the lips."""

LEAST_LUMA = 0.55
"""Smallest luma of teeth over the skin's."""

LEAST_RATIO = (1.25, 1.3)
"""Smallest green over red and blue over red of teeth, each divided by the skin's, which cancels the colour of the
light. By their reflectances it is 1.4 and more; of lips and tongue below 1."""

MOST_REDNESS = 0.75
"""Largest redness of teeth over the skin's."""

CLIPPED = 252 / 255
"""sRGB value from which on a colour may be overexposed."""


def measure_teeth(pixels: UInt8, rim: AnyFloat, skin: npt.ArrayLike) -> Float32 | None:
    """(3,) sRGB median of the brighter half of the teeth between the lips, or None where none are seen.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        rim: (N, 2) pixels round the opening between the lips, in order.
        skin: (3,) sRGB of the face; teeth are less red than it and not much darker.
    """
    typical = np.asarray(skin, np.float32)
    colour, _ = inside_rim(pixels, rim, 0.0)
    pale = colour[toothlike(colour, typical) > 0.5]
    pale = pale[luma(pale) > LEAST_LUMA * float(luma(typical))]
    if len(pale) < max(LEAST_PIXELS, LEAST_SHARE * len(colour)):
        return None
    order = np.argsort(luma(pale), kind="stable")
    return np.asarray(np.median(pale[order[len(order) // 2 :]], 0), np.float32)


def toothlike(colour: Float32, skin: Float32) -> Float32:
    """(n,) in [0, 1]: 1 where sRGB colours (n, 3) are clearly less red than the skin (3,), as teeth are, not lips."""
    limit = MOST_REDNESS * float(_redness(skin))
    return np.asarray(np.clip((limit - _redness(colour)) / 0.05 + 1, 0, 1), np.float32)


def _redness(colour: Float32) -> Float32:
    """(...) red less the mean of green and blue, over red: the ratio makes it independent of the brightness."""
    return np.asarray((colour[..., 0] - colour[..., 1:].mean(-1)) / np.maximum(colour[..., 0], 0.02), np.float32)


def teeth_light(tooth: Float32, skin: npt.ArrayLike) -> Float64 | None:
    """Light on the front teeth.

    Args:
        tooth: (3,) sRGB of the teeth (:func:`measure_teeth`).
        skin: (3,) sRGB of the face, in about the same light.

    Returns:
        (3,) linear RGB radiance, finite and positive, that a white diffuse surface would have in their place; None
        where they are overexposed or not surely teeth.
    """
    if (tooth > CLIPPED).any():
        return None
    shown, typical = (srgb_to_linear(np.asarray(c, np.float32)).astype(np.float64) + 1e-4 for c in (tooth, skin))
    ratio = (shown[1:] / shown[0]) / (typical[1:] / typical[0])
    return np.asarray(shown / TOOTH.astype(np.float64)) if (ratio >= LEAST_RATIO).all() else None
