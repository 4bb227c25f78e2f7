"""A robust model of the person's skin in the photo's light, to segment skin from everything else.

Hair, glasses, hands, collars and walls that the photo shows in place of skin may be kept where they are part of the
face, but must not be continued or mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64
from service.colour import linear_to_lab, luma, srgb_to_linear
from service.light.harmonics import basis
from service.texture.segmentation.zones import Zones

LEAST_TEXELS = 150
"""Fewest texels of visible skin to which a model is fitted."""

DARKEST, BRIGHTEST = -1.3, 0.9
"""Natural logarithms of observed over expected luminance between which a texel may be skin (0.27 to 2.5 times)."""

CHROMA_SIGMAS = 3.5
"""Distance in a*, b* (at expected lightness), in robust standard deviations, up to which a texel is skin."""

LEAST_CHROMA_SIGMA = 3.0
"""Smallest standard deviation of a* and b*."""

LEAST_MIDDLE = 40
"""Fewest texels of cheeks and nose for these to decide what else of the face is skin: a cap can cover half of it."""

WIDER = 1.5
"""Standard deviation of the whole face's chroma relative to that of cheeks and nose."""

COVERED = 0.2
"""Share of the face unlike cheeks and nose from which on one of the two is a cap or a mask."""

DAYLIGHT_CHROMA = np.array([14.0, 16.0])
"""a*, b* of skin in daylight."""

RIDGE = 0.005
"""Weight of the ridge that keeps the shading near ambient light, relative to the data's."""


@dataclass(frozen=True)
class SkinModel:
    """The person's skin in this photo.

    Attributes:
        colour: (3,) float32 sRGB, median of trusted face texels.
        shading: (9,) float64 coefficients of log luminance in spherical harmonics of the normal.
        limits: 2nd and 98th percentile of the log luminance that this gives on the face.
        chroma: (2,) median a*, b* at expected lightness.
        spread: (2,) their robust standard deviations.
        worn: chroma and spread of a cap or mask that covers much of the face; None: there is none.
    """

    colour: Float32
    shading: Float64
    limits: tuple[float, float]
    chroma: Float64
    spread: Float64
    worn: tuple[Float64, Float64] | None = None

    @property
    def cover(self) -> SkinModel | None:
        """The same model with the chroma of the cap or mask in place of the skin's; None where none is worn."""
        return None if self.worn is None else replace(self, chroma=self.worn[0], spread=self.worn[1], worn=None)


def fit_skin_model(colour: Float32, normal: Float32, weight: Float32, zones: Zones) -> SkinModel | None:
    """Fit a model to well-seen texels of the face; None where there are too few.

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
    bare, worn = _bare_skin(srgb_to_linear(colour[chosen]), zones.middle[chosen] > 0.5)
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


def _bare_skin(linear: Float32, middle: Bool) -> tuple[Bool, tuple[Float64, Float64] | None]:
    """Separate skin from a cap or mask that covers much of the face.

    Args:
        linear: (N, 3) linear RGB of texels of the face.
        middle: (N,) whether they lie on cheeks or nose.

    Returns:
        (N,) bool, texels of skin; and median and standard deviation of a*, b* of the cap or mask, None without one.
    """
    everything = np.ones(len(middle), np.bool_)
    if middle.sum() < LEAST_MIDDLE:
        return everything, None
    bright = np.maximum(luma(linear), 1e-3)
    chroma = linear_to_lab(linear * (np.median(bright) / bright)[:, None])[:, 1:]
    typical, spread = _middle_and_spread(chroma[middle])
    like = np.sqrt((((chroma - typical) / (WIDER * spread)) ** 2).sum(1)) < CHROMA_SIGMAS
    if like.mean() > 1 - COVERED:
        return everything, None
    other, other_spread = _middle_and_spread(chroma[~like])
    if np.hypot(*(typical - DAYLIGHT_CHROMA)) <= np.hypot(*(other - DAYLIGHT_CHROMA)):
        return np.asarray(like), (other, other_spread)
    return np.asarray(~like), (typical, spread)


def _middle_and_spread(chroma: Float32) -> tuple[Float64, Float64]:
    """(2,) median and (2,) robust standard deviation (1.4826 MAD) of a*, b* (N, 2)."""
    middle = np.median(chroma, 0).astype(np.float64)
    spread = np.maximum(1.4826 * np.median(np.abs(chroma - middle), 0), LEAST_CHROMA_SIGMA)
    return middle, np.asarray(spread, np.float64)


def _robust_fit(rows: Float64, value: Float64, weight: Float64) -> Float64:
    """(K,) coefficients of ``rows`` (N, K) by iteratively reweighted least squares (Geman-McClure), with a ridge.

    The ridge does not act on the first coefficient, the constant.
    """
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
    skin: SkinModel, colour: Float32, normal: Float32, face: AnyFloat | float = 0.0
) -> Float32:
    """(N,) float32 in [0, 1]: how likely texels are skin, by colour and light.

    Args:
        skin: the model.
        colour: (N, 3) sRGB.
        normal: (N, 3) unit.
        face: (N,) in [0, 1], 1 where skin is expected. There a dark texel may be skin in shade, so its chroma alone
            decides; and a bright one may be skin with a grey highlight, so the excess luminance is subtracted from it
            before its chroma decides (the dichromatic model, Shafer 1985).
    """
    linear = srgb_to_linear(colour)
    lightness = np.log(np.maximum(luma(linear), 1e-3)).astype(np.float64)
    # The shading was fitted to normals of the face only: do not extrapolate.
    expected = np.clip(basis(normal) @ skin.shading, *skin.limits)
    ratio = lightness - expected
    likely = _chroma_likelihood(skin, linear * np.exp(-ratio)[:, None].astype(np.float32))
    dark = np.maximum(_falling(-ratio, -DARKEST - 0.3, -DARKEST), face)
    likely = likely * dark * _falling(ratio, BRIGHTEST - 0.2, BRIGHTEST + 0.2)
    mirrored = (np.exp(lightness) - np.exp(expected))[:, None].astype(np.float32)
    highlight = np.where(ratio > 0, _chroma_likelihood(skin, np.maximum(linear - mirrored, 0)), 0)
    return np.asarray(np.maximum(likely, face * highlight), np.float32)


def _chroma_likelihood(skin: SkinModel, linear: Float32) -> Float64:
    """(N,) in [0, 1] how well linear colours (N, 3), at expected lightness, match the chroma of the skin."""
    lab = linear_to_lab(linear)
    distance = np.sqrt((((lab[:, 1:] - skin.chroma) / skin.spread) ** 2).sum(1))
    return _falling(distance, CHROMA_SIGMAS, 1.5 * CHROMA_SIGMAS)


def _falling(value: Float64, start: float, end: float) -> Float64:
    """Linear ramp from 1 at ``start`` to 0 at ``end``."""
    return np.clip((end - value) / (end - start), 0.0, 1.0)
