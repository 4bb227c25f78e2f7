"""Shaded grey, an input of rho and sigma: the grey texture divided by the smooth light, with its fine shading kept.

A crease is visible by its shading. delta removes that, as it should, and the albedo then shows relief by colour alone.
So the networks of the normals read the texture divided by the smooth light of the whole chart, as in their training
(``models.training.normals.shaded``).
"""

from __future__ import annotations

import numpy as np

from service.colour import FULL_CODE, LUMA, Codes
from service.reflectance.planes import Planes

NAME = "shaded_grey"
"""Channel that holds it."""

LIGHT = ("context_0", "context_1", "context_2")
"""Channels of the logarithm of the light in red, green and blue, which delta reads, too."""

READERS = frozenset({"specular_normal", "diffuse_normal"})
"""Stages that read it."""

GAMMA = 2.2
"""Power law instead of the exact sRGB curve: its error is as smooth as the light, and only detail matters."""

MOST_LIGHT = 4.0
"""Largest magnitude of the natural logarithm of the light that is divided by."""

STRIP = 256
"""Rows of the full map at a time."""


def shaded_grey(planes: Planes, albedo: Codes) -> Codes:
    """(H, W) codes of the grey texture, sRGB-coded, divided by its smooth light.

    Args:
        planes: with ``texture_grey`` and ``LIGHT``.
        albedo: (H, W, 3) codes; its luma is the result where the channels ``LIGHT`` do not exist.
    """
    width, height = planes.size
    result = np.zeros((height, width), np.uint16)
    light_known = all(name in planes.channels for name in LIGHT)
    read, columns = planes.read(["texture_grey", *LIGHT] if light_known else []), np.arange(width)
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        if light_known:
            grey, *logs = read(rows, columns)
            strength = sum(share * one for share, one in zip(LUMA, logs, strict=True))
            strength = np.nan_to_num(np.clip(strength, -MOST_LIGHT, MOST_LIGHT))
            coded = (grey * np.float32(0.5) + np.float32(0.5)) * np.exp(strength * np.float32(-1 / GAMMA))
        else:
            coded = albedo[rows] @ (LUMA / np.float32(FULL_CODE))
        result[rows] = np.rint(np.clip(coded, 0, 1) * np.float32(FULL_CODE)).astype(np.uint16)
    return result
