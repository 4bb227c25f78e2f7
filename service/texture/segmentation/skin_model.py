"""Is it skin? A robust model of the person's own skin under the photo's light.

Hair, glasses, hands, collars and walls that the photo shows in place of skin may stay where they are part of the face,
but nothing may be continued or mirrored from them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from service.colour import linear_to_lab, luma, srgb_to_linear
from service.light.harmonics import basis
from service.texture.segmentation.zones import Zones

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

LEAST_TEXELS = 150
"""With less skin in sight than this no model is made."""

DARKEST, BRIGHTEST = -1.3, 0.9
"""Natural logarithm of observed over expected luminance beyond which a texel is not skin (0.27 and 2.5 times)."""

CHROMA_SIGMAS = 3.5
"""Distance in a*, b* (at expected lightness) in robust standard deviations beyond which a texel is not skin."""

LEAST_CHROMA_SIGMA = 3.0
LEAST_MIDDLE = 40
"""Texels of cheeks and nose from which on they tell what else of the face is skin: a cap covers half of a face."""

AROUND = 1.5
"""By how much colours of the whole face may spread more than those of cheeks and nose."""

MUCH = 0.2
"""Share of the face unlike cheeks and nose from which on it may be the skin, and they a mask."""

USUAL_CHROMA = np.array([14.0, 16.0])
"""a*, b* of skin in daylight."""

RIDGE = 0.005
"""Share of the data's weight that keeps the shading model near plain ambient light."""


@dataclass(frozen=True)
class SkinModel:
    """The person's skin in this photo.

    Attributes:
        colour: (3,) float32 sRGB, weighted median of trusted face texels.
        shading: (9,) float64 coefficients of log luminance over spherical harmonics of the normal.
        limits: lowest and highest log luminance that the shading took on the face.
        chroma: (2,) median a*, b* at expected lightness.
        spread: (2,) their robust standard deviations.
        worn: the same two of a cap or a mask that covers much of the face; None: there is none.
    """

    colour: Float
    shading: Array
    limits: tuple[float, float]
    chroma: Array
    spread: Array
    worn: tuple[Array, Array] | None = None

    @property
    def cover(self) -> SkinModel | None:
        """What is worn as if it were the skin; None where nothing is."""
        return None if self.worn is None else replace(self, chroma=self.worn[0], spread=self.worn[1], worn=None)


def fit_skin_model(colour: Float, normal: Float, weight: Float, zones: Zones) -> SkinModel | None:
    """Model from well-seen face texels, or None where there are too few.

    Args:
        colour: (N, 3) sRGB.
        normal: (N, 3) unit.
        weight: (N,) trust in [0, 1].
        zones: masks of the same texels.
    """
    trust = weight * zones.face * (1 - zones.features) * (1 - zones.scalp) * zones.skin
    chosen = np.flatnonzero(trust > 0.25)
    if len(chosen) < LEAST_TEXELS:
        return None
    chosen = chosen[:: max(1, len(chosen) // 8000)]
    bare, worn = _bare(srgb_to_linear(colour[chosen]), zones.middle[chosen] > 0.5)
    chosen = chosen[bare]
    linear = srgb_to_linear(colour[chosen])
    lightness = np.log(np.maximum(luma(linear), 1e-3)).astype(np.float64)
    rows, t = basis(normal[chosen]), trust[chosen].astype(np.float64)
    shading = _robust_fit(rows, lightness, t)
    lab = linear_to_lab(linear * np.exp(rows @ shading - lightness)[:, None].astype(np.float32))
    near = np.abs(lightness - rows @ shading) < 0.5
    if near.sum() < LEAST_TEXELS // 2:
        near[:] = True
    chroma, spread = _middle_and_spread(lab[near, 1:])
    low, high = np.percentile(rows @ shading, [2, 98])
    typical = np.median(colour[chosen][near], 0).astype(np.float32)
    return SkinModel(typical, shading, (float(low), float(high)), chroma, spread, worn)


def _bare(linear: Float, middle: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.bool_], tuple[Array, Array] | None]:
    """(N,) what of a face is skin, and a*, b* of a cap or a mask that covers much of it, if one does.

    Args:
        linear: (N, 3) RGB of the face.
        middle: (N,) cheeks and nose.
    """
    everything = np.ones(len(middle), np.bool_)
    if middle.sum() < LEAST_MIDDLE:
        return everything, None
    bright = np.maximum(luma(linear), 1e-3)
    chroma = linear_to_lab(linear * (np.median(bright) / bright)[:, None])[:, 1:]
    typical, spread = _middle_and_spread(chroma[middle])
    like = np.sqrt((((chroma - typical) / (AROUND * spread)) ** 2).sum(1)) < CHROMA_SIGMAS
    if like.mean() > 1 - MUCH:
        return everything, None
    other, other_spread = _middle_and_spread(chroma[~like])
    if np.hypot(*(typical - USUAL_CHROMA)) <= np.hypot(*(other - USUAL_CHROMA)):
        return np.asarray(like), (other, other_spread)
    return np.asarray(~like), (typical, spread)


def _middle_and_spread(chroma: Float) -> tuple[Array, Array]:
    """(2,) median and robust standard deviation of a*, b* (N, 2)."""
    middle = np.median(chroma, 0).astype(np.float64)
    spread = np.maximum(1.4826 * np.median(np.abs(chroma - middle), 0), LEAST_CHROMA_SIGMA)
    return middle, np.asarray(spread, np.float64)


def _robust_fit(rows: Array, value: Array, weight: Array) -> Array:
    """Coefficients by iteratively reweighted least squares (Geman-McClure), pulled towards a constant."""
    robust = np.ones(len(value))
    ridge = np.diag([1e-9] + [1.0] * (rows.shape[1] - 1))
    fitted = np.zeros(rows.shape[1])
    fitted[0] = np.median(value)
    for _ in range(6):
        residual = value - rows @ fitted
        scale = max(2.5 * 1.4826 * float(np.median(np.abs(residual))), 0.1)
        robust = weight / (1 + (residual / scale) ** 2) ** 2
        weighted = rows * robust[:, None]
        matrix = weighted.T @ rows + (RIDGE * robust.sum() + 1e-9) * ridge
        fitted = np.linalg.solve(matrix, weighted.T @ value)
    return fitted


def skin_likelihood(
    skin: SkinModel, colour: Float, normal: Float, face: npt.NDArray[np.floating] | float = 0.0
) -> Float:
    """(N,) float32, 1 = skin as far as colour and light tell, 0 = something else.

    Args:
        skin: the model.
        colour: (N, 3) sRGB.
        normal: (N, 3) unit.
        face: (N,) in [0, 1], 1 where skin is to be expected: a dark texel may be skin in shade, so that its chroma
            alone decides, and a bright one skin that mirrors a lamp, whose colour is what is left without as much grey
            as makes it brighter than expected (the dichromatic model, Shafer 1985).
    """
    linear = srgb_to_linear(colour)
    lightness = np.log(np.maximum(luma(linear), 1e-3)).astype(np.float64)
    # Normals that the face does not have were not fitted: keep the prediction within what was seen.
    expected = np.clip(basis(normal) @ skin.shading, *skin.limits)
    ratio = lightness - expected
    likely = _like(skin, linear * np.exp(-ratio)[:, None].astype(np.float32))
    dark = np.maximum(_fall(-ratio, -DARKEST - 0.3, -DARKEST), face)
    likely = likely * dark * _fall(ratio, BRIGHTEST - 0.2, BRIGHTEST + 0.2)
    mirrored = (np.exp(lightness) - np.exp(expected))[:, None].astype(np.float32)
    shining = np.where(ratio > 0, _like(skin, np.maximum(linear - mirrored, 0)), 0)
    return np.asarray(np.maximum(likely, face * shining), np.float32)


def _like(skin: SkinModel, linear: Float) -> Array:
    """(N,) in [0, 1] whether linear colours (N, 3) at expected lightness have the chroma of the skin."""
    lab = linear_to_lab(linear)
    distance = np.sqrt((((lab[:, 1:] - skin.chroma) / skin.spread) ** 2).sum(1))
    return _fall(distance, CHROMA_SIGMAS, 1.5 * CHROMA_SIGMAS)


def _fall(value: Array, start: float, end: float) -> Array:
    """1 up to ``start``, 0 from ``end``, straight between."""
    return np.clip((end - value) / (end - start), 0.0, 1.0)
