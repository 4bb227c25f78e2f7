"""How far the fine detail of a map was drawn by super-resolution, an input of rho and sigma.

The detail that zeta draws is the light stage's skin, whose colour follows its height: its pores are dark and deep. On
skin that a photo shows they hardly have to do with each other (``benchmarks.real_skins``). So the networks of the
normals are told which they look at, as in their training (``models.training.normals``), and draw the relief that
belongs to drawn pores, but none from a photo's own pigment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import Float32
from service.reflectance.relief.shading import RELIEF
from service.reflectance.subject import GEOMETRY_SIZE
from service.texture.detail.result import Octave

NAME = "drawn_detail"
"""Channel that holds it: -1 where all fine detail is the photo's, 1 where all is drawn."""


def drawn_detail(seen: Float32 | None, octaves: Sequence[Octave], strength: float) -> Float32:
    """(h, w) float32 in [-1, 1] at ``GEOMETRY_SIZE``: values of the channel.

    Octaves count by the power of relief that skin has in them.

    Args:
        seen: (H, W) in [0, 1], how far texels show the photo; None: there is no photo.
        octaves: what the photo tells of each, finest first; none where nothing of it was brought onto the map.
        strength: in [0, 1], of the detail that super-resolution drew; 0 where it did not run.
    """
    import cv2

    power = np.square(RELIEF[-len(octaves) :] if octaves else RELIEF)
    shares = np.array([octave.share for octave in octaves][: len(power)] or [0.0])
    told = float(np.clip((shares * power[: len(shares)]).sum() / power[: len(shares)].sum(), 0, 1))
    shown = np.zeros((1, 1), np.float32) if seen is None else np.clip(np.nan_to_num(seen), 0, 1)
    across = cv2.resize(np.asarray(shown, np.float32), GEOMETRY_SIZE, interpolation=cv2.INTER_LINEAR)
    return np.asarray(2 * np.clip(strength, 0, 1) * (1 - told * across) - 1, np.float32)
