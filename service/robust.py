"""Weights: robust ones of iteratively re-weighted least squares, and smooth ramps."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64


def geman_mcclure(residual: Float64, scale: Float64 | float) -> Float64:
    """Weights in (0, 1] of residuals, any shape: 1 at 0, 1/4 at ``scale`` > 0 (Geman and McClure 1987)."""
    return np.asarray((1.0 + (residual / scale) ** 2) ** -2)


def agreement(values: Float32, weights: Float32, shown: Bool, scale: float) -> Float32:
    """(K, ...) in (0, 1] how near what each of K witnesses says is to the weighted median; 1 where fewer than three say
    anything (``shown``). At a distance of ``scale`` from the median a witness counts a quarter.
    """
    order = np.argsort(values, axis=0)
    ordered, share = np.take_along_axis(values, order, 0), np.take_along_axis(weights, order, 0)
    half = np.cumsum(share, 0) >= 0.5 * share.sum(0)
    middle = np.take_along_axis(ordered, half.argmax(0)[None], 0)
    near = geman_mcclure((values - middle).astype(np.float64), scale)
    return np.asarray(np.where(shown.sum(0) >= 3, near, 1.0), np.float32)


def smoothstep(value: AnyFloat, low: AnyFloat | float, high: AnyFloat | float) -> Float32:
    """Cubic ramp of values of any shape, from 0 at ``low`` to 1 at ``high``, which may be less than ``low``."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
