"""The colour of each strand, from the photo: its own where it is seen, else like those that are.

Brightness is told strand by strand, without the slow changes over the head that are the photo's light. Hue follows
brightness as it does over all of the hair's pixels: single pixels of dark hair have that of noise and of the sky.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import Float32
from service.colour import bytes_to_linear, luma
from service.geometry.sampling import sample_at
from service.hair.colour import KNOTS, HairColour, as_absorbed
from service.hair.reading import CELLS
from service.hair.sight import Sight
from service.image_filters import blurred
from service.photo.photo import Photo

PIXELS = 3 * CELLS
"""Pixels along the square from which colours are taken."""
LEAST_PIXELS = 150
"""Fewest of them, well within hair, from which its colour is measured: 17 cells."""
LIGHT_CELLS = 7.0
"""Standard deviation of the blur that tells the photo's light on the hair, cells: 27 mm."""
LIGHT_TAKEN = 0.75
"""Power of that light that is taken out: the rest may be a fringe that is fairer."""
BLACK = 0.0035
"""Linear value of the brightest channel up to which a photo's shadow is crushed to black, whatever hair lies in it
(code 11 of 255)."""
RANKS = (0.06, 0.94)
"""Ranks of brightness beyond which pixels are gaps and background, or mirror a lamp."""
MOST_STEEP = 0.8
"""Most by which the logarithm of a channel may rise beside that of luminance: more is two materials."""
OWN = 0.7
"""Share of a seen strand's own departure from the mean that it keeps: the rest is its neighbours' and noise."""
CONTRAST = 0.9
"""Least spread of brightness over strands, over that of the photo's pixels: means along strands are more alike."""
USUAL_SPREAD = 0.16
"""Standard deviation of the logarithm of luminance from strand to strand, where none are seen."""
DARKEST, BRIGHTEST = 0.006, 0.75
"""Range of linear luminance of hair: what a photo shows darker lies in shadow."""


def painted(photo: Photo, sight: Sight | None, strands: Float32, seen: Float32, skin: Float32, seed: int) -> HairColour:
    """Colours of strands in the photo's light.

    Args:
        photo: that was fitted.
        sight: where its hair is; None where that is not known.
        strands: (N, P, 3) metres, root first.
        seen: (N,) share of each that the photo shows.
        skin: (3,) linear RGB of the person's skin in the photo; hair is guessed from it where little is seen.
        seed: of what is random.
    """
    rng = np.random.default_rng([seed, 0xC01])
    count = len(strands)
    guess = np.log(np.maximum(skin * np.array([0.12, 0.09, 0.075], np.float32), 1e-4))
    if sight is None:
        return _guessed(guess, count, rng)
    pixels = bytes_to_linear(sight.region.cut(photo.pixels, PIXELS))
    grown = np.kron(np.asarray(blurred(sight.hair, 0.8) > 0.75, np.float32), np.ones((3, 3), np.float32))
    bright = np.log(np.maximum(luma(pixels), 1e-4))
    inner = (grown > 0.5) & (pixels.max(-1) < 0.98) & (pixels.max(-1) > BLACK)
    if int(inner.sum()) < LEAST_PIXELS:
        return _guessed(guess, count, rng)
    low, high = np.quantile(bright[inner], RANKS)
    inner &= (bright >= low) & (bright <= high)
    mean = float(bright[inner].mean())
    # What changes slowly over the hair is its light.
    weight = inner.astype(np.float32)
    sigma = LIGHT_CELLS * PIXELS / CELLS
    summed = blurred(np.stack([weight * (bright - mean), weight], -1).astype(np.float32), sigma)
    light = summed[..., 0] / np.maximum(summed[..., 1], 1e-3)
    flat = np.asarray(np.clip(bright - LIGHT_TAKEN * light, low, high), np.float32)
    offset, slope = _hue(np.log(np.maximum(pixels[inner], 1e-4)), bright[inner])
    level = _levels(strands, seen, sight, flat, weight, float(flat[inner].mean()), rng)
    level -= np.median(level)
    level *= np.clip(CONTRAST * float(flat[inner].std()) / max(float(level.std()), 1e-3), 1, 2)
    # As much light comes off all of them as off the hair in the photo.
    level = np.clip(level + np.log(float(np.exp(bright[inner]).mean()) / float(np.exp(level).mean())), low, high)
    level = np.clip(level, np.log(DARKEST), np.log(BRIGHTEST))
    return as_absorbed(np.exp(np.clip(offset + slope * level[..., None], -6.5, np.log(0.9))))


def _guessed(usual: Float32, count: int, rng: np.random.Generator) -> HairColour:
    """Strands of one colour, the logarithm of linear RGB (3,), which differ in brightness."""
    level = rng.normal(0, USUAL_SPREAD, (count, 1)).astype(np.float32)
    return replace(as_absorbed(np.exp(usual + np.repeat(level, KNOTS, 1)[..., None])), measured=False)


def _hue(logs: Float32, bright: Float32) -> tuple[Float32, Float32]:
    """Offset (3,) and slope (3,) of the logarithm of each channel over that of luminance."""
    middle = logs.mean(0), float(bright.mean())
    spread = bright - middle[1]
    size = max(float((spread**2).sum()), 1e-6)
    slope = np.clip((spread[:, None] * (logs - middle[0])).sum(0) / size, 1 - MOST_STEEP, 1 + MOST_STEEP)
    return np.asarray(middle[0] - slope * middle[1], np.float32), np.asarray(slope, np.float32)


def _levels(
    strands: Float32, seen: Float32, sight: Sight, flat: Float32, weight: Float32, mean: float,
    rng: np.random.Generator,
) -> Float32:  # fmt: skip
    """(N, KNOTS) logarithm of luminance of strands from root to tip."""
    at = np.linspace(0, strands.shape[1] - 1, KNOTS).round().astype(int)
    cell, depth = sight.project(strands[:, at])
    _, before = sight.visible(cell, depth)
    place = (cell * (PIXELS / CELLS) - 0.5).reshape(-1, 2)
    soft = blurred(np.stack([flat * weight, weight], -1).astype(np.float32), 1.0)
    read = sample_at(soft, place[:, 0], place[:, 1]).reshape(*cell.shape[:2], 2)
    trust = np.where(before & (read[..., 1] > 0.3), np.clip(2 * seen, 0, 1)[:, None], 0)
    own = np.where(trust > 0, read[..., 0] / np.maximum(read[..., 1], 1e-3), mean) - mean
    # From root to tip as those that are seen, and from strand to strand as they differ.
    told = trust.sum(0)
    along = (trust * own).sum(0) / (told + 20.0)
    per = trust.sum(1)
    middle = (trust * (own - along)).sum(1) / np.maximum(per, 1e-6)
    enough = per > 1.5
    spread = float(np.std(middle[enough])) if int(enough.sum()) > 50 else USUAL_SPREAD
    random = rng.normal(0, float(np.clip(spread, 0.05, 0.35)), len(strands))
    base = np.where(enough, OWN * middle, random)
    detail = trust * (own - along - middle[:, None]) * OWN
    return np.asarray(mean + along + base[:, None] + detail, np.float32)
