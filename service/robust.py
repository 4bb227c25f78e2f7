"""Robust weights of iteratively re-weighted least squares."""

from __future__ import annotations

import numpy as np

from service.arrays import Float64


def geman_mcclure(residual: Float64, scale: Float64 | float) -> Float64:
    """Weights in (0, 1] of residuals, any shape: 1 at 0, 1/4 at ``scale`` > 0 (Geman and McClure 1987)."""
    return np.asarray((1.0 + (residual / scale) ** 2) ** -2)
