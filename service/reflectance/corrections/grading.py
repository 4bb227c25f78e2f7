"""Hues that follow the light: what a photo's grading did, and neither skin nor lamp.

Cameras, films and filters bend each channel's tone curve by itself. Where they bend much, shade is redder and yellower
than lit skin, and so is the albedo that is left when the light is taken away; the network has seen plain photos only.
Skin's own hue has nothing to do with how much light falls on it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.corrections.on_light import LightCorrection
from service.reflectance.corrections.skin_hue import FEW

Float = npt.NDArray[np.float32]

USUAL = 0.2
"""Change of log red / green, or blue / green, by log light that plain photos have too: skylight in shade, red skin that
happens to lie there."""

MOST = 1.0
"""Largest change that is taken for grading: with more, a channel is gone rather than bent."""

LEAST_SPREAD = 0.05
"""Standard deviation of log light below which nothing follows it."""

DARKEST = 0.003
"""Linear value below which 8 bits do not tell a hue."""

ODD = 2.5
"""Median distances from the line beyond which a texel is lips, brow or paint, and does not count."""


def even_hue(light: Float, linear: Float, lit: Float) -> Float:
    """(3, h, w) log light, redder or bluer by its strength, so that the albedo's hue does not follow it.

    What is within ``USUAL`` stays bit for bit; green stays as it is.

    Args:
        light: (3, h, w) log light that was found.
        linear: (3, h, w) linear RGB texture.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    chosen = (lit > 0.5) & (linear > DARKEST).all(0)
    if chosen.sum() < FEW:
        return light
    strength = light.mean(0)
    at = strength[chosen].astype(np.float64)
    log_albedo = np.log(linear[:, chosen].astype(np.float64)) - light[:, chosen]
    low, high = np.quantile(at, (0.02, 0.98))
    along = (np.clip(strength, low, high) - np.float32(at.mean())).astype(np.float32)
    slopes = np.array([_slope(at, log_albedo[channel] - log_albedo[1]) for channel in range(3)])
    beyond = np.sign(slopes) * np.clip(np.abs(slopes) - USUAL, 0.0, MOST)
    return np.asarray(light + beyond.astype(np.float32)[:, None, None] * along, np.float32)


def _slope(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> float:
    """Of the line through (x, y), without those far off it; 0 where x hardly varies."""
    kept = np.ones(len(x), bool)
    slope = 0.0
    for _ in range(3):
        if kept.sum() < FEW or x[kept].std() < LEAST_SPREAD:
            return 0.0
        a, b = x[kept] - x[kept].mean(), y[kept] - y[kept].mean()
        slope = float((a * b).sum() / (a * a).sum())
        away = np.abs(y - y[kept].mean() - slope * (x - x[kept].mean()))
        kept = away <= ODD * max(float(np.median(away)), 1e-6)
    return slope


GRADING = LightCorrection(
    name="grading",
    mends="Tone curves of single channels make the hue of the albedo follow the strength of the light.",
    source="light",
    cases=("graded",),
    apply=lambda at: even_hue(at.light, at.texture, at.weight),
)
