"""Grain for inpainted skin: noise in 3-D space, so that the chart's stretch does not draw it out into streaks."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, Float64
from service.geometry.chart import Chart

BAND = (0.8, 2.5)
"""Standard deviations of the two Gaussians whose difference is the band, in cells of the noise."""

SIDE = 64
"""Cells along each side of the cube of noise, which repeats."""

FINEST_M = 0.0007
"""Smallest cell, metres on the mean head: a texel of AvatarMe's texture on the face."""

OCTAVES = 4
"""Cell sizes, each twice the one before."""


def grain(chart: Chart, seed: int) -> Float32:
    """(N, 1) float32 mirror-symmetric band-limited noise at the inner texels, of mean magnitude 1.

    Its cells are as large as the longer side of the texel: finest on the face, coarser on the neck, whose texels are
    long and narrow.

    Args:
        chart: of the head; positions are those of the mean head, so that grain does not move with expressions.
        seed: of the random generator.
    """
    position = chart.interpolate(chart.head.mean)
    place = position.reshape(-1, 3)[chart.texels].astype(np.float64)
    place[:, 0] = np.abs(place[:, 0])
    octave = np.clip(np.log2(np.maximum(_texel(chart, position), FINEST_M) / FINEST_M), 0, OCTAVES - 1)
    block = _block(seed)
    total = np.zeros(len(place))
    for index in range(OCTAVES):
        share = np.clip(1 - np.abs(octave - index), 0, 1)
        chosen = np.flatnonzero(share > 0)
        # Square roots of the shares: variances of independent noises add.
        cells = place[chosen] / (FINEST_M * 2**index) + 17.3 * index
        total[chosen] += np.sqrt(share[chosen]) * _sample(block, cells)
    return np.asarray(total[:, None] / max(float(np.abs(total).mean()), 1e-9), np.float32)


def _texel(chart: Chart, position: Float32) -> Float32:
    """(N,) metres, longer side of each inner texel, median-filtered over 5 x 5 texels."""
    import cv2

    filled = chart.fill_outside(position)
    sides = [np.linalg.norm(np.gradient(filled, axis=axis), axis=2) for axis in (0, 1)]
    longer = np.maximum(*sides).astype(np.float32)
    return np.asarray(cv2.medianBlur(longer, 5), np.float32).ravel()[chart.texels]


def _block(seed: int) -> Float64:
    """(SIDE, SIDE, SIDE) float64 band-limited noise of unit variance that repeats without a seam."""
    noise = np.random.default_rng(seed).standard_normal((SIDE,) * 3)
    axis = 2 * np.pi * np.fft.fftfreq(SIDE)
    square = axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis[None, None, : SIDE // 2 + 1] ** 2
    band = np.exp(-0.5 * BAND[0] ** 2 * square) - np.exp(-0.5 * BAND[1] ** 2 * square)
    result = np.fft.irfftn(np.fft.rfftn(noise) * band, (SIDE,) * 3, axes=(0, 1, 2))
    return np.asarray(result / result.std(), np.float64)


def _sample(block: Float64, cells: Float64) -> Float64:
    """(N,) trilinearly interpolated values of a repeating cube of noise at points (N, 3) in cells."""
    low = np.floor(cells)
    part = cells - low
    corner = low.astype(np.int64)
    result = np.zeros(len(cells))
    for offset in np.ndindex(2, 2, 2):
        weight = np.where(offset, part, 1 - part).prod(1)
        x, y, z = ((corner + offset) % SIDE).T
        result += weight * block[x, y, z]
    return result
