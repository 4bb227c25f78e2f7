"""Compositing of surfaces that are partly transparent, pixel by pixel from near to far."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Int64


def transmittances(pixel: Int64, alpha: AnyFloat) -> Float32:
    """(N,) float32 share of light that reaches each fragment through those before it.

    Args:
        pixel: (N,) pixel of each fragment, ascending; fragments of one pixel from near to far.
        alpha: (N,) opacity in [0, 1].
    """
    # Products over runs of equal pixels are differences of running sums of logarithms; opacity 1 would be infinite.
    through = np.log(np.maximum(1.0 - np.asarray(alpha, np.float64), 1e-9))
    before = np.concatenate([[0.0], np.cumsum(through)[:-1]]) if len(through) else through
    first = np.searchsorted(pixel, pixel)
    return np.asarray(np.exp(before - before[first]), np.float32) if len(through) else np.zeros(0, np.float32)


def composite(pixel: Int64, colour: AnyFloat, alpha: AnyFloat, count: int) -> Float32:
    """(count, C + 1) float32 colours premultiplied by coverage, and the coverage in [0, 1], of all pixels.

    Args:
        pixel: as in :func:`transmittances`, below ``count``.
        colour: (N, C).
        alpha: (N,) in [0, 1].
        count: of pixels.
    """
    share = transmittances(pixel, alpha) * np.asarray(alpha, np.float32)
    planes = [np.bincount(pixel, share * np.asarray(colour)[:, k], count) for k in range(np.asarray(colour).shape[1])]
    return np.stack([*planes, np.bincount(pixel, share, count)], 1).astype(np.float32)
