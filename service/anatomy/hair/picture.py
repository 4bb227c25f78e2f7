"""The texture of a style of hair in somebody's colours."""

from __future__ import annotations

import numpy as np

from service.anatomy.hair.colour import CONTRAST, LIGHT, NEUTRAL, SHADE, HairColour
from service.anatomy.hair.item import Item
from service.arrays import Float32, UInt8
from service.colour import linear_to_srgb, luma
from service.geometry.raster import interpolate, rasterise

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
    import cv2

    grey, alpha = item.picture[..., 0], item.picture[..., -1]
    solid = np.sort(grey[alpha > 127]) if (alpha > 127).any() else np.zeros(1, np.uint8)
    table = sum(np.searchsorted(solid, np.arange(256), side) for side in ("left", "right")) / (2 * len(solid))
    # Half ranks, half levels: ranks alone would draw out what noise there is in an even picture.
    low, high = (float(np.quantile(solid, q)) for q in (0.05, 0.95))
    level = np.clip((np.arange(256) - low) / max(high - low, 8.0), 0, 1)
    # Between levels too: in a dark picture a third of the texels have one level, and its border would be an edge.
    soft = np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), LEVELS_PX * grey.shape[1] / 512))
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
    import cv2

    if item.along is None:
        return np.ones_like(along)
    grey = item.picture[..., 0].astype(np.float32)
    strands = grey - np.asarray(cv2.GaussianBlur(grey, (0, 0), STRANDS_PX * grey.shape[1] / 512))
    uneven = strands / max(float(strands.std()), 1e-3)
    t = np.clip(along / HAIRLINE + 0.25 * uneven * (along < HAIRLINE), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def _on_texture(item: Item) -> Float32:
    """(H, W) the coordinate from root to tip of the cards, extended between them; 0.5 without one."""
    import cv2

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
    soft = np.asarray(cv2.GaussianBlur(both.reshape(height, width, 2), (0, 0), SPREAD * width))
    return np.asarray(np.clip((soft[..., 0] + 1e-3 * 0.5) / (soft[..., 1] + 1e-3), 0, 1), np.float32)
