"""What no skin is like is light: a cap's shadow, a coloured lamp's patch, a pale sheen, a chin in shade.

The context network tells smooth light and leaves what is steep or strongly coloured in the albedo. But the albedo of
one person's skin varies little from place to place, and the prior of whole albedo maps says how (``albedo_prior``):
given all that is seen, a cheek is not half as bright as the forehead, nor yellow beside a pink one. What lies beyond
such bounds counts as light. What is expected is found robustly: texels beyond the bounds do not tell what the rest is
like. The difference is smoothed without crossing edges (median, and a bilateral filter: Tomasi and Manduchi 1998), so
that a shadow with a hard edge goes as a whole, and pores, freckles, lines and moles stay.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from service.arrays import Float32
from service.colour import LUMA
from service.image_filters import blurred
from service.reflectance.albedo.albedo_prior import AlbedoPrior
from service.reflectance.albedo.corrections import ChartLight, LightCorrection

BOUNDS = ((-0.35, 0.30), (-0.2, 0.2), (-0.2, 0.2))
"""Natural logarithms of luminance, of red over green and of blue over green, beyond which skin is not taken to differ
from what the prior expects there."""
BEYOND = 0.1
"""Share of what lies beyond that stays."""
DOUBT = 0.15
"""Excess at which a texel's say in what the rest is like falls to a third."""
ROUNDS = 3
SPOT = 5
"""Width of the median filter that takes spots off, texels of the context, 1.5 mm each."""
EDGE = (9, 0.3, 3.0)
"""Width of the bilateral filter in texels of the context; its standard deviations in logarithm and in
texels."""
GAP = 2.0
"""Standard deviation of the blur that fills what is no lit skin before it, texels."""
AROUND = 6.0
"""The same of the blur by which brows, lids and borders share the light of the skin around."""
OWN_HUE = 0.15
"""Excess of red over green in the prior's mean, natural logarithm, from which on skin has a hue of its own: lips, rims
of lids."""
LEAST = 200.0
"""Fewest texels of lit skin that tell what the rest is like."""


def within_bounds(light: Float32, texture: Float32, lit: Float32, prior: AlbedoPrior) -> Float32:
    """(3, h, w) log light that leaves no albedo which no skin has.

    Args:
        light: as it was found.
        texture: (3, h, w) linear.
        lit: (h, w) in [0, 1], where skin is seen in it; with too little of it the light stays as it is.
        prior: of whole albedo maps of this chart.
    """
    if float(lit.sum()) < LEAST:
        return light
    albedo = np.log(np.maximum(texture, np.float32(1e-3))) - light
    judged = lit * _of_usual_hue(prior, lit.shape)
    near = np.maximum(blurred(judged, GAP), np.float32(1e-3))
    trust, excess = judged, np.zeros_like(light)
    for _ in range(ROUNDS):
        apart = _opponents(albedo - prior.complete(albedo, trust))
        filled = np.stack([_without_spots(judged * p + (1 - judged) * blurred(p * judged, GAP) / near) for p in apart])
        base = cv2.bilateralFilter(np.ascontiguousarray(np.moveaxis(filled, 0, 2), np.float32), *EDGE)
        excess = _beyond(np.moveaxis(np.asarray(base, np.float32), 2, 0))
        trust = judged * np.exp(-np.square(np.abs(excess).max(0) / np.float32(DOUBT)))
    wide = blurred(judged, AROUND)
    shared = np.stack([blurred(p * judged, AROUND) for p in excess]) / np.maximum(wide, np.float32(1e-3))
    field: Any = judged * excess + (1 - judged) * shared * np.minimum(4 * wide, 1)
    return np.asarray(light + _colours(np.asarray(field, np.float32)), np.float32)


def _of_usual_hue(prior: AlbedoPrior, shape: tuple[int, ...]) -> Float32:
    """(h, w) in [0, 1], 0 on lips and rims of lids."""
    red = prior.mean[0] - prior.mean[1]
    usual = np.asarray(red - np.median(red[prior.inside > 0.5]) < OWN_HUE, np.float32)
    return np.asarray(cv2.resize(usual, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def _without_spots(plane: Float32) -> Float32:
    """(h, w) without moles, creases and lashes: median of ``SPOT`` texels."""
    return np.asarray(cv2.medianBlur(np.ascontiguousarray(plane, np.float32), SPOT), np.float32)


def _opponents(logs: Float32) -> Float32:
    """(3, h, w) luminance, red over green and blue over green of log RGB."""
    return np.stack([np.tensordot(LUMA, logs, 1), logs[0] - logs[1], logs[2] - logs[1]]).astype(np.float32)


def _colours(opponents: Float32) -> Float32:
    """(3, h, w) log RGB of :func:`_opponents`."""
    bright, red, blue = opponents
    green = bright - LUMA[0] * red - LUMA[2] * blue
    return np.stack([green + red, green, green + blue])


def _beyond(apart: Float32) -> Float32:
    """(3, h, w) of differences what counts as light."""
    bounds = np.array(BOUNDS, np.float32)[..., None, None]
    return np.asarray((1 - BEYOND) * (apart - np.clip(apart, bounds[:, 0], bounds[:, 1])), np.float32)


def _apply(at: ChartLight) -> Float32:
    prior = at.prior
    return at.light if prior is None else within_bounds(at.light, at.texture, at.weight, prior)


UNLIKE_SKIN = LightCorrection(
    name="unlike-skin",
    mends="Shadows with hard edges, patches of coloured light and pale sheens stay in the albedo.",
    cases=("cap", "hard", "graded"),
    apply=_apply,
)
