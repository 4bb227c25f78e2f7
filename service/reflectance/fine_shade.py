"""The grey skin that rho and sigma read: texture without the light that the context told, its fine shade left in.

A crease is seen by its shade. delta takes that away, as it should; the albedo tells of relief by colour alone. So the
networks of the normals get the texture divided by the smooth light of the whole chart, which they were trained on
(``models.training.normals.shaded``).
"""

from __future__ import annotations

import numpy as np

from service.colour import FULL_CODE, LUMA, Codes
from service.reflectance.planes import Planes

NAME = "shaded_grey"
"""Channel of it."""
LIGHT = ("context_0", "context_1", "context_2")
"""Channels of the log light of red, green and blue, which delta reads too."""
READERS = frozenset({"specular_normal", "diffuse_normal"})
"""Stages that read it."""
GAMMA = 2.2
"""Of sRGB, nearly: what a smooth light is off by then is smooth, and only detail is looked at."""
MOST_LIGHT = 4.0
"""Natural logarithm of the strongest light that is divided by, and of what the darkest is."""
STRIP = 256
"""Rows of the full map at a time."""


def shaded_grey(planes: Planes, albedo: Codes) -> Codes:
    """(H, W) codes of the grey texture, sRGB-coded, without its smooth light.

    Args:
        planes: with ``texture_grey`` and ``LIGHT``.
        albedo: (H, W, 3) codes; its luma is the result where no channel tells of the light.
    """
    width, height = planes.size
    result = np.zeros((height, width), np.uint16)
    told = all(name in planes.channels for name in LIGHT)
    read, columns = planes.read(["texture_grey", *LIGHT] if told else []), np.arange(width)
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        if told:
            grey, *logs = read(rows, columns)
            strength = sum(share * one for share, one in zip(LUMA, logs, strict=True))
            strength = np.nan_to_num(np.clip(strength, -MOST_LIGHT, MOST_LIGHT))
            coded = (grey * np.float32(0.5) + np.float32(0.5)) * np.exp(strength * np.float32(-1 / GAMMA))
        else:
            coded = albedo[rows] @ (LUMA / np.float32(FULL_CODE))
        result[rows] = np.rint(np.clip(coded, 0, 1) * np.float32(FULL_CODE)).astype(np.uint16)
    return result
