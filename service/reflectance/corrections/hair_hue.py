"""Hair: a hue that hair has.

Nearly black, brows and hair tell no hue in a photo: a warm lamp divided out of a black that it did not warm leaves
blue, the shades of a film or a scan leave purple. Both melanins absorb blue most and red least.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import luma
from service.ledger import Correction

Float = npt.NDArray[np.float32]

BLACK, DARK = 0.12, 0.24
"""sRGB luma up to which what covers skin is taken for hair whatever its hue, and from which it keeps it: cloth may."""

REDDEST, MORE_RED = 1.25, 3.0
"""Red over luma, on sRGB values, that black hair has at most; and by how much it grows with a luma over ``GREYEST``.

Dark brown hair (60, 40, 30) has 1.38, auburn (90, 45, 30) has 1.63.
"""
GREYEST = 0.1


def like_hair(albedo: Float, brow: Float, hair: Float) -> Float:
    """(h, w, 3) albedo whose brows, and dark hair elsewhere, have no more green than red and no more blue than green.

    Where it changes, its luma stays; dark hair is no redder than hair of its luma is.

    Args:
        albedo: (h, w, 3) sRGB, 0 to 1 coded as -1 to 1.
        brow: (h, w) in [0, 1], where brows may lie (``service.reflectance.corrections.brows.brow_plane``).
        hair: (h, w) in [0, 1], where hair of the head or of a beard may lie.
    """
    if not (brow.any() or hair.any()):
        return albedo
    # Only what is to change: a map has millions of texels, and most of them are right.
    red, green, blue = (albedo[..., k] for k in range(3))
    level = luma(albedo) * np.float32(0.5) + np.float32(0.5)
    weight = np.maximum(brow, hair * np.clip((DARK - level) / np.float32(DARK - BLACK), 0, 1))
    wrong = (green > red) | (blue > green) | (red + 1 > 2 * REDDEST * level)
    at = np.flatnonzero(wrong & (weight > 0))
    before = albedo.reshape(-1, 3)[at] * np.float32(0.5) + np.float32(0.5)
    level, weight = level.ravel()[at], weight.ravel()[at]
    changed = np.array(albedo, np.float32)
    changed.reshape(-1, 3)[at] += 2 * weight[:, None] * (_brown(before, level) - before)
    return changed


def _brown(colour: Float, level: Float) -> Float:
    """(N, 3) colours of hair nearest to colours (N, 3) of luma (N,)."""
    red, green, blue = colour.T
    green = np.minimum(red, green)
    brown = np.stack([red, green, np.minimum(green, blue)], 1)
    brown *= (level / np.maximum(luma(brown), np.float32(1e-4)))[:, None]
    most = REDDEST + MORE_RED * np.maximum(level - np.float32(GREYEST), 0)
    redness = brown[:, 0] - level
    share = np.minimum((most - 1) * level / np.maximum(redness, np.float32(1e-4)), 1)[:, None]
    # Black of one channel alone has no luma to be kept without it.
    return np.asarray(level[:, None] + share * (np.minimum(brown, 1) - level[:, None]), np.float32)


HAIR_HUE = Correction(
    name="hair-hue",
    mends="Nearly black hair and brows come out blue or purple when the light is divided out.",
    source="albedo",
    cases=("brows", "beard"),
)
