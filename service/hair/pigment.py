"""Pigment of hair that a photo shows: the likeliest of many heads of hair, under what is told of the light.

A photo shows the product of pigment and light, and over it what strands mirror. The light on the hair is not that on
the face: a sun behind the head, a lamp above it, a shadow. So no factor leads from one to the other. Here heads of hair
are drawn as often as there are such, each is put into the light that the face tells, and counts by how near it comes to
the photo's colour for what is known of that light (Bayes' rule; by Student's t, as some light is all different).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64
from service.colour import luma
from service.hair.colour import GREY, PIGMENTS, SHINE, reflected

OFTEN = np.array([
    (0.30, 3.2, 0.15), (0.22, 1.3, 0.15), (0.14, 0.75, 0.15), (0.08, 0.38, 0.12), (0.06, 0.2, 0.09), (0.06, 0.11, 0.07),
    (0.01, 0.03, 0.02), (0.05, 0.5, 0.7), (0.03, 0.12, 0.8), (0.02, 0.03, 0.35),
])  # fmt: skip
"""How often hair has which concentrations of eumelanin and pheomelanin before it turns grey: black, four browns, three
blonds, auburn, red, copper."""
TURNED, WHITE, SOME = 0.07, (1.5, 1.2), 0.1
"""How often hair is turning grey, the beta distribution of the share of white hairs in it, and that from which on it
counts as grey."""
AMOUNT = 0.4
"""Standard deviation of the logarithm of either pigment about its colour's."""
HEADS = 6000
"""Heads of hair that are drawn: half as many moved natural colours by 5 % at most."""
GLOSS = SHINE * 2.0 ** np.arange(-1.0, 4.0)
GLOSS_SPREAD = 1.4
"""What strands mirror, over the light on the face, and the standard deviation of its base-2 logarithm."""
ACROSS = np.array([[1, 1, 1], [1, 0, -1], [-1, 2, -1]]) / np.sqrt([[3.0], [2.0], [6.0]])
"""Unit vectors of logarithmic RGB: brightness, red over blue, green over both."""
OF_LIGHT = np.array([0.8, 0.06, 0.06])
"""Standard deviation along these of the light on hair about that on the face, where this is white and of usual
strength."""
OF_FAR_LIGHT = np.array([1.0, 0.45, 0.45])
"""The same over how far the light that is told lies from that: a light far from common is told less surely."""
OF_SKY = np.array([0.0, 0.35, 0.18])
"""The same of what strands mirror alone, which is the sky or a lamp."""
OF_HAIR = np.array([0.0, 0.12, 0.08])
"""Standard deviation of the hair itself about what melanin has."""
FREEDOM = 8.0
"""Degrees of freedom of Student's t."""
DYED = 0.02
"""How often hair has a colour that none has by nature."""
DYE = np.array([1.7, 0.9, 0.5])
DYE_USUAL = np.log(0.1)
"""Standard deviation of the logarithm of the albedo of dyed hair, and its mean."""


@dataclass(frozen=True)
class Pigment:
    """What hair has without the photo's light.

    Attributes:
        albedo: (3,) float32 linear RGB in (0, 1), the mean of the logarithm over what is likely.
        grey: probability in [0, 1] that a tenth of it or more is white.
        dyed: probability in [0, 1] that no hair has its colour by nature.
    """

    albedo: Float32
    grey: float
    dyed: float


@lru_cache(maxsize=1)
def _heads() -> tuple[Float64, Bool]:
    """Linear RGB (HEADS, 3) of heads of hair under white light, half of them turning grey, and which do (HEADS,)."""
    rng = np.random.default_rng(0x4A1)
    melanin = OFTEN[rng.choice(len(OFTEN), HEADS, p=OFTEN[:, 0] / OFTEN[:, 0].sum()), 1:]
    melanin = melanin * np.exp(rng.normal(0, AMOUNT, melanin.shape))
    white = np.where(np.arange(HEADS) % 2, SOME + (1 - SOME) * rng.beta(*WHITE, HEADS), 0.0)[:, None]
    bare = melanin * np.minimum(1.0, GREY / melanin.sum(1, keepdims=True))
    return (1 - white) * reflected(melanin @ PIGMENTS) + white * reflected(bare @ PIGMENTS), white[:, 0] > 0


def told_pigment(shown: AnyFloat, light: AnyFloat, turned: float = TURNED) -> Pigment:
    """The pigment of hair of a usual colour in a photo.

    Args:
        shown: (3,) linear RGB in the photo, clipped to [0.002, 0.95].
        light: (3,) factors from colours in the light that the hair is told to have to albedo, clipped to [0.01, 100].
        turned: probability in (0, 1) that the person's hair is turning grey, before it is looked at.
    """
    albedo, white = _heads()
    brighter = np.log(np.clip(light, 1e-2, 1e2).astype(np.float64))
    seen = np.log(np.clip(shown, 2e-3, 0.95).astype(np.float64))
    of_light = np.square(OF_LIGHT) + np.square(OF_FAR_LIGHT * (ACROSS @ brighter))
    often = np.exp(-0.5 * np.square(np.log2(GLOSS / SHINE) / GLOSS_SPREAD))
    weights, logs = np.zeros(HEADS), np.zeros((HEADS, 3))
    for amount, share in zip(GLOSS, often / often.sum(), strict=True):
        mirrors = amount / (luma(albedo) + amount)
        spread = of_light + np.square(OF_HAIR) + np.outer(np.square(mirrors), np.square(OF_SKY))
        off = (seen + brighter - np.log(albedo + amount)) @ ACROSS.T
        likely = share * np.where(white, turned, 1 - turned) * _density(off, spread)
        weights += likely
        logs += likely[:, None] * (np.log(albedo) + (np.square(OF_HAIR) / spread * off) @ ACROSS)
    strange = DYED * _density(((seen + brighter - DYE_USUAL) @ ACROSS.T)[None], (of_light + np.square(DYE))[None])[0]
    dyed = strange / (strange + (1 - DYED) * 2 * weights.mean())
    grey = float(weights[white].sum() / weights.sum())
    alike = white == (grey > 0.5)  # between brown and grey lies a hair that nobody has
    own = seen + brighter if dyed > 0.5 else logs[alike].sum(0) / weights[alike].sum()
    return Pigment(np.clip(np.exp(own), 1e-3, 0.9).astype(np.float32), grey, float(dyed))


def _density(off: Float64, spread: Float64) -> Float64:
    """(N,) density of Student's t, but for a factor, of what is off (N, 3) by variances (N, 3)."""
    far = (np.square(off) / spread).sum(1) / FREEDOM
    return np.asarray((1 + far) ** (-0.5 * (FREEDOM + 3)) / np.sqrt(spread.prod(1)))
