"""The colours of a person's hair, measured in a photo."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Bool, Float32
from service.colour import luma

LEAST_PIXELS = 40
"""Fewest pixels of hair from which its colour is measured."""
LEAST_END = 25
"""Fewest pixels near the roots, and near the tips, for the two to be told apart."""
ENDS = (0.25, 0.75)
"""Ranks by the coordinate from root to tip up to which pixels count as roots, and from which on as tips: of what the
photo shows, as hair that is cut has its tips where it was cut."""
LEAST_APART = 0.2
"""Least difference of that coordinate between the two, for them to be told apart."""
SHADE, LIGHT = (0.1, 0.4), (0.6, 0.9)
"""Ranks by luminance, from which the colours of shaded and of lit strands are taken; the extremes are gaps between
strands, and background."""
CONTRAST = (1.7, 2.6)
"""Smallest and largest ratio of lit to shaded strands: less is lost in the photo's resolution, more is its light."""
MOST_FADING = 1.8
"""Largest ratio between tips and roots in a channel, either way."""
GREY = 0.18
"""Saturation (1 - min / max of linear RGB) below which lit strands are grey; the share falls to 0 at twice that."""
NEUTRAL = np.array([1.12, 0.97, 0.86], np.float32)
"""Tint of black hair, of luminance 1 about: eumelanin absorbs blue most (Zonios et al. 2008)."""
WRONG = 0.15
"""Excess of green over red, or of blue over green, from which on hair has the whole of that tint: a little is noise of
grey hair."""
DYED = 0.5
"""Saturation from which on hair that no melanin colours counts as dyed."""


@dataclass(frozen=True)
class HairColour:
    """Colours in the photo's light, (3,) float32 linear RGB.

    Attributes:
        shaded, lit: of the darker and of the brighter strands.
        root, tip: factors on both at the roots and at the tips.
        ends: coordinates from root to tip, of the style that was compared, between which the first goes over into the
            second.
        grey: share of lit strands without pigment, in [0, 1].
        sheen: how much brighter highlights are than usual strands, >= 1.
        measured: whether the photo showed enough hair; else all is a guess.
    """

    shaded: Float32
    lit: Float32
    root: Float32
    tip: Float32
    grey: float
    sheen: float
    measured: bool
    ends: tuple[float, float] = (0.0, 1.0)

    @property
    def usual(self) -> Float32:
        """(3,) mean of shaded and lit."""
        return np.asarray(0.5 * (self.shaded + self.lit), np.float32)

    def natural(self, light: Float32) -> HairColour:
        """The same with an albedo that melanin can have.

        Args:
            light: (3,) factors > 0 from colours in the photo's light to albedo.
        """
        return replace(self, shaded=as_melanin(self.shaded * light) / light, lit=as_melanin(self.lit * light) / light)


def measure(colours: Float32, along: Float32, certain: Bool) -> HairColour | None:
    """Colours of hair.

    Args:
        colours: (N, 3) linear RGB of pixels.
        along: (N,) coordinate from root to tip of the style that is worn; 0 beside it, which counts as unknown.
        certain: (N,) whether a pixel shows hair.

    Returns:
        None where too few are certain.
    """
    own, where = colours[certain], along[certain]
    if len(own) < LEAST_PIXELS:
        return None
    bright = luma(own)
    rank = np.argsort(np.argsort(bright, kind="stable"), kind="stable") / len(own)
    shaded, lit, top = (
        np.maximum(np.median(own[(rank >= low) & (rank <= high)], 0), 1e-4) for low, high in (SHADE, LIGHT, (0.95, 1.0))
    )
    ratio = float(luma(lit) / max(float(luma(shaded)), 1e-6))
    apart = np.float32(np.sqrt(float(np.clip(ratio, *CONTRAST)) / max(ratio, 1e-6)))
    shaded, lit = shaded / apart, lit * apart  # their geometric mean stays
    fading, ends = np.ones(3), (0.0, 1.0)
    if int((where > 0).sum()) >= 2 * LEAST_END:
        low, high = (float(np.quantile(where[where > 0], rank)) for rank in ENDS)
        pair = own[(where > 0) & (where <= low)], own[where >= high]
        if high - low >= LEAST_APART and min(len(end) for end in pair) >= LEAST_END:
            middles = [np.maximum(np.median(end, 0), 1e-4) for end in pair]
            fading = np.clip(np.sqrt(middles[1] / middles[0]), MOST_FADING**-0.5, MOST_FADING**0.5)
            ends = (low, high)
    saturation = 1 - float(lit.min()) / max(float(lit.max()), 1e-6)
    f = np.float32
    return HairColour(
        shaded.astype(f), lit.astype(f), np.asarray(1 / fading, f), np.asarray(fading, f),
        float(np.clip(2 - saturation / GREY, 0, 1)), max(float(luma(top)) / max(float(luma(lit)), 1e-6), 1.0),
        True, ends,
    )  # fmt: skip


def as_melanin(albedo: Float32) -> Float32:
    """(3,) linear albedo of hair with no more green than red, and no more blue than green.

    Both melanins absorb the more the shorter the wave (d'Eon 2011, table 1). Black hair shows more of what it mirrors
    than of itself: window or sky; divided by the warmer light on the skin it would come out violet. Channels in the
    wrong order are brought to the tint of black hair (isotonic regression beside it); dyed hair (``DYED``) keeps its
    colour.
    """
    if 1 - float(albedo.min()) / max(float(albedo.max()), 1e-6) > DYED:
        return albedo
    excess = max(float(albedo[1] / max(albedo[0], 1e-6)), float(albedo[2] / max(albedo[1], 1e-6))) - 1
    tint = NEUTRAL ** np.float32(np.clip(excess / WRONG, 0, 1))
    red, green, blue = (float(value) for value in albedo / tint)
    if green > red:
        red = green = 0.5 * (red + green)
    if blue > green:
        green = blue = 0.5 * (green + blue)
    if green > red:
        red = green = blue = (red + green + blue) / 3
    made = np.array([red, green, blue], np.float32) * tint
    return np.asarray(made * (luma(albedo) / max(float(luma(made)), 1e-6)), np.float32)


def guessed(skin: Float32, brow: Float32 | None = None) -> HairColour:
    """Colours where no hair is seen: those of the brows, else dark brown.

    Args:
        skin: (3,) linear RGB of the person's skin in the photo's light.
        brow: (3,) linear RGB of the brows' dark pixels in it, or None.
    """
    usual = np.asarray(skin, np.float32) * np.array([0.12, 0.09, 0.075], np.float32) if brow is None else brow
    one = np.ones(3, np.float32)
    f = np.float32
    return HairColour(np.asarray(usual * f(0.7), f), np.asarray(usual * f(1.3), f), one, one, 0.0, 1.0, False)
