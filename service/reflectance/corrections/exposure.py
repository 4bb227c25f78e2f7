"""How bright a light can be where neither a sclera nor teeth are seen: sensors end at 1, and photographers know it.

Skin alone does not tell dark skin in bright light from fair skin in dim light. A photo may be underexposed by any
amount; but where a white surface in the light of the face would be far beyond what the sensor can show, skin is fairer
than the network takes it for more often than the photo is overexposed.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.ledger import Constant
from service.reflectance.corrections.on_light import LightCorrection

USUAL, SPREAD = -0.82, 0.72
"""Mean and standard deviation over photos of the log radiance of a white diffuse surface in the face's light, where
the sclera is seen; by ``benchmarks.eye_whites --photos``."""
UNSURE = 0.44
"""Standard deviation of the network's error in that logarithm where it sees no sclera."""
SHARE = UNSURE**2 / (UNSURE**2 + SPREAD**2)
"""Share of the excess over ``USUAL`` that is taken off: the mean of the product of the two normal distributions."""


def mean_light(light: Float32, lit: Float32) -> Float32:
    """(3,) mean of (3, h, w) weighted by ``lit`` (h, w) in [0, 1]; of everywhere if nowhere is lit."""
    weight = lit if float(lit.sum()) >= 1 else np.ones_like(lit)
    return np.asarray((light * weight).sum((1, 2)) / np.float32(weight.sum()), np.float32)


def less_overexposed(light: Float32, lit: Float32) -> Float32:
    """(3, h, w) log light, less by one number where it is brighter than the light of photos usually is.

    Args:
        light: of a face that shows no sclera.
        lit: (h, w) in [0, 1], lit skin; nowhere counts as everywhere.
    """
    mean = float(mean_light(light, lit).mean())
    return np.asarray(light - np.float32(SHARE * max(mean - USUAL, 0.0)), np.float32)


EXPOSURE = LightCorrection(
    name="exposure",
    mends="Without a sclera or teeth in the photo, light far beyond what a sensor can show is taken for real.",
    source="light",
    constants={
        "usual": Constant((USUAL, SPREAD), "log radiance: mean, standard deviation", "benchmarks.eye_whites --photos"),
        "unsure": Constant(UNSURE, "log radiance, standard deviation", "docs/training.md, no eyes seen"),
    },
    cases=("overexposed", "no-eyes"),
    apply=lambda at: at.light if at.white_seen else less_overexposed(at.light, at.weight),
)
