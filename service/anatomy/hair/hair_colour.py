"""The colours of a person's hair, measured in a photo, and the texture of a style of hair in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.anatomy.hair.wearables import Item
from service.arrays import Bool, Float32, UInt8
from service.colour import linear_to_srgb, luma
from service.geometry.raster import interpolate, rasterise
from service.image_filters import blurred

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


def measure_hair(colours: Float32, along: Float32, certain: Bool) -> HairColour | None:
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


BRIGHTEST = 0.75
"""Largest albedo of hair, linear."""
DARKEST = 0.011
"""Least luminance of the usual strands' albedo, linear: black hair is no hole. What a photo shows darker than that lies
in shadow, or under a tone curve that crushes it."""
SPREAD = 0.008
"""Blur of the coordinate from root to tip on the texture, over its width: cards that share texels differ."""
HAIRLINE = 0.05
"""Coordinate up to which cards fade in at the roots, strand by strand: a hairline is no edge."""
LEVELS_PX = 0.8
"""Standard deviation of the blur between levels of grey, texels of 512."""
OWN = 0.5
"""Share of the contrast beyond the two colours that is the strands' own: the rest is the photo's light on them."""
STRANDS_PX = 3.0
"""Standard deviation of the blur that strands are told from, texels of 512."""


def hair_picture(item: Item, colour: HairColour, light: Float32) -> UInt8:
    """(H, W, 4) uint8 sRGB albedo with straight alpha, row 0 at v = 1.

    The asset's own luminance says which strands are lit and which shaded; its ranks go to the photo's colours.

    Args:
        item: the style; its picture has grey and alpha.
        colour: in the photo's light.
        light: (3,) factors from colours in the photo's light to albedo.
    """
    grey, alpha = item.picture[..., 0], item.picture[..., -1]
    solid = np.sort(grey[alpha > 127]) if (alpha > 127).any() else np.zeros(1, np.uint8)
    table = sum(np.searchsorted(solid, np.arange(256), side) for side in ("left", "right")) / (2 * len(solid))
    # Half ranks, half levels: ranks alone would draw out what noise there is in an even picture.
    low, high = (float(np.quantile(solid, q)) for q in (0.05, 0.95))
    level = np.clip((np.arange(256) - low) / max(high - low, 8.0), 0, 1)
    # Between levels too: in a dark picture a third of the texels have one level, and its border would be an edge.
    soft = blurred(grey.astype(np.float32), LEVELS_PX * grey.shape[1] / 512)
    lit = np.interp(soft, np.arange(256), 0.5 * table + 0.5 * level).astype(np.float32)[..., None]
    along = _on_texture(item)[..., None]
    shaded, bright = (np.maximum(one, np.float32(1e-5)) for one in lifted(colour.shaded * light, colour.lit * light))
    # The two colours are medians of ranges of ranks: the darkest and the brightest strands lie beyond them.
    low, high = (0.5 * sum(ranks) for ranks in (SHADE, LIGHT))
    between = (lit - np.float32(low)) / np.float32(high - low)
    beyond = between - np.clip(between, 0, 1)
    usual = shaded + np.clip(between, 0, 1) * (bright - shaded)
    usual *= (luma(bright) / luma(shaded)) ** (np.float32(OWN) * beyond)
    low, high = colour.ends
    faded = np.clip((along - low) / max(high - low, 1e-3), 0, 1)
    albedo = usual * (colour.root + faded * (colour.tip - colour.root))
    coded = linear_to_srgb(np.clip(albedo, 0, np.float32(BRIGHTEST)).astype(np.float32))
    opaque = np.rint(alpha * _fading(item, along[..., 0])).astype(np.uint8)
    return np.concatenate([np.rint(255 * coded).astype(np.uint8), opaque[..., None]], 2)


def lifted(shaded: Float32, lit: Float32) -> tuple[Float32, Float32]:
    """Albedo (3,) of shaded and of lit strands, at least as bright as black hair and then as neutral.

    A channel that the photo's cast has taken away, or that is crushed to black, comes back as far as it has to.
    """
    usual = float(luma(0.5 * (shaded + lit)))
    missing = max(DARKEST - usual, 0.0)
    if missing <= 0:
        return shaded, lit
    share = missing / DARKEST
    own = float(luma(lit)) / max(float(luma(shaded)), 1e-6)
    ratio = float(np.sqrt(np.clip(own, *CONTRAST)))
    middle = np.float32(DARKEST) * NEUTRAL
    # What is left of the measured colour still counts by how much of it was there.
    dark, bright = middle / np.float32(ratio), middle * np.float32(ratio)
    return (
        np.asarray((1 - share) * shaded + share * dark, np.float32),
        np.asarray((1 - share) * lit + share * bright, np.float32),
    )


def _fading(item: Item, along: Float32) -> Float32:
    """(H, W) factor on alpha in [0, 1]: 0 at the roots, 1 from ``HAIRLINE`` on, uneven from strand to strand."""
    if item.along is None:
        return np.ones_like(along)
    grey = item.picture[..., 0].astype(np.float32)
    strands = grey - blurred(grey, STRANDS_PX * grey.shape[1] / 512)
    uneven = strands / max(float(strands.std()), 1e-3)
    t = np.clip(along / HAIRLINE + 0.25 * uneven * (along < HAIRLINE), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def _on_texture(item: Item) -> Float32:
    """(H, W) the coordinate from root to tip of the cards, extended between them; 0.5 without one."""
    height, width = item.picture.shape[:2]
    if item.along is None:
        return np.full((height, width), 0.5, np.float32)
    at = np.stack([item.uv[:, 0] * width, (1 - item.uv[:, 1]) * height], 1)
    drawn = rasterise(at, np.zeros(len(at)), item.triangles, width, height)
    shown = np.flatnonzero(drawn.mask)
    both = np.zeros((height * width, 2), np.float32)
    corners = item.triangles[drawn.triangle.ravel()[shown]]
    both[shown, 0] = interpolate(item.along[:, None], corners, drawn.barycentric.reshape(-1, 3)[shown])[:, 0]
    both[shown, 1] = 1
    soft = blurred(both.reshape(height, width, 2), SPREAD * width)
    return np.asarray(np.clip((soft[..., 0] + 1e-3 * 0.5) / (soft[..., 1] + 1e-3), 0, 1), np.float32)
