"""Skin of which the photo has no blue left: in warm light the camera cuts it off before red is dark.

What is 0 under any light says nothing of the albedo, and next to it noise would be divided by nearly nothing; cheeks
turn mustard. There blue follows from red and green, in the ratio that the same skin has where all three are seen.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import linear_to_srgb, srgb_to_linear
from service.ledger import Correction

Float = npt.NDArray[np.float32]

LOST = (3 / 255, 14 / 255)
"""sRGB values of blue up to which it tells nothing, and from which it tells all."""

LIT = (24 / 255, 60 / 255)
"""sRGB values of red up to which everything is dark, as in hair, and from which only blue is missing."""

LEAST_TEXELS = 50
"""Texels of the context by which the usual blue is told."""

LEAST_SHARE = 0.02
"""Share of the lit skin without blue from which the result says so."""


def missing(texture: Float) -> Float:
    """(...) in [0, 1]: 1 where sRGB values (..., 3) in [0, 1] have no blue though they are not dark, by half a code.

    Only where red >= green >= blue, as of skin in warm light: a red lip or a brown cheek, never a blue cap.
    """
    red, green, blue = (np.asarray(texture[..., i], np.float32) for i in range(3))
    lost = np.clip((LOST[1] - blue) / (LOST[1] - LOST[0]), 0, 1)
    lit = np.clip((red - LIT[0]) / (LIT[1] - LIT[0]), 0, 1)
    return np.asarray(lost * lit * ((red >= green) & (green >= blue)), np.float32)


def usual_blue(albedo: Float, texture: Float, weight: Float) -> float | None:
    """Median of blue over the geometric mean of red and green of a skin; None where too little of it is well seen.

    Args:
        albedo: (N, 3) linear.
        texture: (N, 3) sRGB in [0, 1] that it was made from.
        weight: (N,) in [0, 1], skin in the photo's light.
    """
    seen = (weight > 0.5) & (texture[:, 2] >= LOST[1]) & (texture[:, 0] >= LIT[1]) & (albedo[:, :2] > 1e-3).all(1)
    if int(seen.sum()) < LEAST_TEXELS:
        return None
    return float(np.median(albedo[seen, 2] / np.sqrt(albedo[seen, 0] * albedo[seen, 1])))


def with_blue(albedo: Float, lost: Float, blue: float) -> Float:
    """Albedo (N, 3), sRGB in [0, 1], with a share ``lost`` (N,) of its blue made ``blue`` times red and green."""
    linear = srgb_to_linear(albedo)
    made = np.float32(blue) * np.sqrt(linear[:, 0] * linear[:, 1])
    linear[:, 2] += lost * (made - linear[:, 2])
    return linear_to_srgb(linear)


def lacks_blue(texture: npt.NDArray[np.uint8], lit: Float | None) -> bool:
    """Whether a texture (h, w, 3) lacks blue on a share of its lit skin (any size, None: everywhere) worth a word."""
    import cv2

    lost = missing(texture * np.float32(1 / 255))
    weight = np.ones_like(lost) if lit is None else np.asarray(cv2.resize(lit, lost.shape[::-1]), np.float32)
    return float((lost * weight).sum()) > LEAST_SHARE * max(float(weight.sum()), 1.0)


CLIPPED_BLUE = Correction(
    name="clipped-blue",
    mends="In warm light the sensor clips blue to 0 on lit skin, which divided by the light is mustard.",
    source="albedo",
    cases=("warm", "clipped"),
)
