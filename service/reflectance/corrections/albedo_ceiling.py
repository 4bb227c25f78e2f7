"""Skin that would glow: shade that the head has and the photo has not.

Where the fitted head errs, an ear's hollow say, the network sees a deep fold that the photo shows lit. Divided by the
fold's shade, skin comes out far brighter than anywhere else on the person, and all that is continued from there too.
Lids lie in the deepest fold of the face, and are no fairer than it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.corrections.on_light import LightCorrection

Float = npt.NDArray[np.float32]

MOSTLY = 0.9
"""Share of the lit skin that is no brighter than the brightness which is beyond doubt."""
ABOVE = 0.12
"""By how much skin may be brighter than that, in logarithms."""
LIDS_MOSTLY = 0.6
"""The same share for lids, which may not be brighter than that at all."""
SOFT = 2.0
"""Standard deviation of the blur over which brightness is judged, texels of the context: finer is the skin's own."""
DARKEST = 1e-3
"""Linear value at which logarithms stop."""
FEW = 50
"""With less lit skin than this nothing is usual."""


def below_ceiling(light: Float, texture: Float, lit: Float, lids: Float) -> Float:
    """(3, h, w) log light, more where lit skin would come out brighter than skin of one person is.

    Args:
        light: log light that was found.
        texture: (3, h, w) linear RGB.
        lit: (h, w) in [0, 1], where the light is to be believed; elsewhere it stays.
        lids: (h, w) in [0, 1], skin round the eyes.
    """
    import cv2

    if float(lit.sum()) < FEW:
        return light
    albedo = (np.log(np.maximum(texture, np.float32(DARKEST))) - light).mean(0)
    weight = np.asarray(cv2.GaussianBlur(lit, (0, 0), SOFT), np.float32)
    soft = np.asarray(cv2.GaussianBlur(albedo * lit, (0, 0), SOFT), np.float32) / np.maximum(weight, np.float32(1e-6))
    chosen = lit > 0.5
    if chosen.sum() < FEW:
        return light
    high, lids_high = np.quantile(soft[chosen], (MOSTLY, LIDS_MOSTLY))
    most = high + ABOVE + np.clip(lids, 0, 1) * (lids_high - high - ABOVE)
    beyond = np.maximum(soft - most, 0)
    return np.asarray(light + np.where(lit > 0, beyond, 0), np.float32)


ALBEDO_CEILING = LightCorrection(
    name="albedo-ceiling",
    mends="Where the fitted head has a fold that the photo does not show, lit skin comes out too bright.",
    source="light",
    cases=("soft", "hard"),
    apply=lambda at: below_ceiling(at.light, at.texture, at.weight, at.lids),
)
