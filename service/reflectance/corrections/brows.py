"""Brows: the light on the skin under them, which no photo shows.

Brows are dark hair at a place where shade is to be expected. A network that has seen brows of medium depth takes the
rest of a darker one for shade, and bleaches it. So its findings there do not count: light goes on from the skin around.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.corrections.on_light import LightCorrection
from service.reflectance.corrections.unseen_light import continued

Float = npt.NDArray[np.float32]

NONE = 0.02
"""Up to which a soft mask counts as 0."""


def under_brows(everywhere: Float, light: Float, lit: Float, brow: Float) -> Float:
    """(C, h, w) log light whose brows have the light of the skin around them; as it was where there are none.

    Args:
        everywhere: (C, h, w) that is to be changed.
        light: (C, h, w) what the network found.
        lit: (h, w) in [0, 1], where that is to be believed.
        brow: (h, w) in [0, 1], of :func:`service.anatomy.brows.brow_plane`.
    """
    import cv2

    # Not by soft weights: the nearest texels, however little they weigh, would decide, and they are half brow.
    beside = np.where(brow > NONE, np.float32(0), lit).astype(np.float32)
    if beside.sum() < 1 or not brow.any():
        return everywhere
    soft = np.minimum(np.asarray(cv2.GaussianBlur(brow, (0, 0), 1.0), np.float32), brow) * lit
    return np.asarray(everywhere + soft * (continued(light, beside) - everywhere), np.float32)


BROW_LIGHT = LightCorrection(
    name="brow-light",
    mends="Brows darker than those of the training are taken for shade and bleached.",
    source="light",
    cases=("brows",),
    apply=lambda at: under_brows(at.light, at.found, at.lit, at.brows) if at.brows.any() else at.light,
)
