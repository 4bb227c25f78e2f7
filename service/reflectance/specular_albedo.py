"""psi: specular albedo (AvatarMe, section 4.3)."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.colour import Codes, to_codes
from service.reflectance.translate import MapInputs, translate

NAME = "psi"

ELSEWHERE = 0.65
"""Specular albedo of eyes, teeth and tongue: F0 = 0.04 * 0.65 = 0.026, that of water and the cornea (index 1.38)."""


def specular_albedo(job: MapInputs) -> Codes:
    """(H, W) codes, linear; ``ELSEWHERE`` off the skin. The job's planes hold ``albedo_*``.

    Raises:
        ModelFault: the network is missing, changed, or does not fit.
    """
    result = np.zeros(job.skin.shape, np.uint16)
    elsewhere = np.float32(2 * ELSEWHERE - 1)

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        result[place] = to_codes(elsewhere + skin * (np.clip(values[0], -1, 1) - elsewhere))

    translate(NAME, job, 1, keep)
    return result
