"""Teeth between the lips: which pixels are teeth, what colour they have, and what they tell of the light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.sclera import inside_rim
from service.anatomy.teeth.colours import TOOTH
from service.colour import luma, srgb_to_linear

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

LEAST_PIXELS = 24
LEAST_LUMA, LEAST_SHARE = 0.55, 0.08
"""Of teeth, over the skin's luma, and of the opening between the lips."""
PALER = (1.25, 1.3)
"""Times by which teeth have more green and blue over red than the skin, under whatever light. By their reflectances it
is 1.4 and more; lips and tongue have less than the skin."""
LESS_RED = 0.75
"""Share of the skin's redness that teeth have at most."""
CLIPPED = 252 / 255
"""sRGB value from which a colour may be overexposed."""


def measure_teeth(pixels: npt.NDArray[np.uint8], rim: npt.NDArray[np.floating], skin: npt.ArrayLike) -> Float | None:
    """(3,) sRGB of the teeth between the lips, or None where none are seen.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        rim: (N, 2) pixels round the opening between the lips, in order.
        skin: (3,) sRGB; teeth are paler than it and not much darker.
    """
    usual = np.asarray(skin, np.float32)
    colour, _ = inside_rim(pixels, rim, 0.0)
    pale = colour[toothlike(colour, usual) > 0.5]
    pale = pale[luma(pale) > LEAST_LUMA * float(luma(usual))]
    if len(pale) < max(LEAST_PIXELS, LEAST_SHARE * len(colour)):
        return None
    order = np.argsort(luma(pale), kind="stable")
    return np.asarray(np.median(pale[order[len(order) // 2 :]], 0), np.float32)


def toothlike(colour: Float, skin: Float) -> Float:
    """(n,) 1 where colours (n, 3) are paler than the skin (3,): lips that the fit took for teeth are not."""
    limit = LESS_RED * float(_redness(skin))
    return np.asarray(np.clip((limit - _redness(colour)) / 0.05 + 1, 0, 1), np.float32)


def _redness(colour: Float) -> Float:
    """(...) red less green and blue, as a share of red; in dim light everything is less red but for this."""
    return np.asarray((colour[..., 0] - colour[..., 1:].mean(-1)) / np.maximum(colour[..., 0], 0.02), np.float32)


def teeth_light(tooth: Float, skin: npt.ArrayLike) -> Array | None:
    """Light on the front teeth.

    Args:
        tooth: (3,) sRGB that the photo shows of them (:func:`measure_teeth`).
        skin: (3,) sRGB of the face, in about the same light.

    Returns:
        (3,) linear RGB radiance, finite and positive, that a white diffuse surface would have in their place; None
        where it is not certain that they are teeth, or where they are overexposed.
    """
    if (tooth > CLIPPED).any():
        return None
    shown, usual = (srgb_to_linear(np.asarray(c, np.float32)).astype(np.float64) + 1e-4 for c in (tooth, skin))
    paler = (shown[1:] / shown[0]) / (usual[1:] / usual[0])
    return np.asarray(shown / TOOTH.astype(np.float64)) if (paler >= PALER).all() else None
