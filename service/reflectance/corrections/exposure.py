"""How bright a light can be, where no white of an eye tells: sensors end at 1, and photographers know.

Skin alone does not tell dark skin in bright light from fair skin in dim light. A photo may be underexposed by any
amount; but where a white surface in the light of the face would be far beyond what the sensor can show, skin is fairer
than the network takes it for more often than the photo is overexposed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.corrections.on_light import LightCorrection

Float = npt.NDArray[np.float32]

USUAL, SPREAD = -0.82, 0.72
"""Mean and standard deviation of log(light on the face) over photos whose whites of the eyes are seen: linear values
that a white diffuse surface has; ``benchmarks.eye_whites --photos``."""
UNSURE = 0.44
"""Standard deviation of the network's error in it where it sees no eyes; the median of its size is 0.29, and stands in
docs/training.md."""
SHARE = UNSURE**2 / (UNSURE**2 + SPREAD**2)
"""What is taken off of a light beyond the usual one: the mean of two normal distributions."""


def mean_light(light: Float, lit: Float) -> Float:
    """(3,) mean of (3, h, w) where ``lit`` (h, w) in [0, 1] says that it is to be believed; nowhere is everywhere."""
    weight = lit if float(lit.sum()) >= 1 else np.ones_like(lit)
    return np.asarray((light * weight).sum((1, 2)) / np.float32(weight.sum()), np.float32)


def less_overexposed(light: Float, lit: Float) -> Float:
    """(3, h, w) log light, less by one number where it is brighter than photos usually are.

    Args:
        light: of a face that shows no white of an eye.
        lit: (h, w) in [0, 1], where it is to be believed; nowhere counts as everywhere.
    """
    mean = float(mean_light(light, lit).mean())
    return np.asarray(light - np.float32(SHARE * max(mean - USUAL, 0.0)), np.float32)


EXPOSURE = LightCorrection(
    name="exposure",
    mends="Without a sclera or teeth in the photo, light far beyond what a sensor can show is taken for real.",
    source="light",
    cases=("overexposed", "no-eyes"),
    apply=lambda at: at.light if at.white_seen else less_overexposed(at.light, at.weight),
)
