"""Weights: robust ones of iteratively re-weighted least squares, and smooth ramps."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Float64


def geman_mcclure(residual: Float64, scale: Float64 | float) -> Float64:
    """Weights in (0, 1] of residuals, any shape: 1 at 0, 1/4 at ``scale`` > 0 (Geman and McClure 1987)."""
    return np.asarray((1.0 + (residual / scale) ** 2) ** -2)


def smoothstep(value: AnyFloat, low: float, high: float) -> Float32:
    """Cubic ramp of values of any shape, from 0 at ``low`` to 1 at ``high``, which may be less than ``low``."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
