"""Robust integration of slopes, which keeps cliffs: depth discontinuities, as at a nostril or between the lips.

The slopes of neighbouring texels across a cliff belong to no common surface, and least squares spreads the
contradiction over a region as wide as the cliff is long. Here each equation between neighbours is weighted by its
residual (Geman-McClure, iteratively reweighted least squares: Agrawal, Raskar, Chellappa 2006, section 5; Queau, Durou,
Aujol 2018, section 4), so that a few equations on the cliff are given up and all others are met. The weights of
bilateral normal integration (Cao et al. 2022), which compare the residuals at both sides of a texel, do not help at
this scale: a cliff of a millimetre spans a few texels, and the residuals at both sides are alike.

This is done on a map at most ``WIDTH`` texels wide; its difference to least squares is added to the full map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32
from service.reflectance.relief.integrate import Edges, differences, integrate, joined, wanted

WIDTH = 1536
"""Largest width of the map on which cliffs are sought, texels."""

ROUNDS = 24
"""Most rounds of reweighting."""

SETTLED_MM = 2e-4
"""Rounds end when no height changes by more than this."""

LEAST_SCALE = 0.05
"""Smallest scale of the residuals, as a slope, beyond which equations lose weight."""

NOISE = 3.5
"""That scale relative to the residuals' robust standard deviation."""

LEAST_WEIGHT = 1e-3
"""Smallest weight of an equation, so that none is dropped altogether."""

CUT = 0.25
"""An equation of less weight counts as given up."""

_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal variable."""


@dataclass(frozen=True)
class Robust:
    """Heights (H, W) float32 in mm, of mean 0 over the mask; rounds taken; and the share of equations given up."""

    height: Float32
    rounds: int
    cut: float


def integrate_robustly(right: Float32, down: Float32, mask: Bool, texel_mm: Float32, start: Float32) -> Robust:
    """Heights from slopes by robust least squares, which gives up the few equations that cannot be met.

    Args:
        right: (H, W) float32 change of height in mm per texel to the right.
        down: the same per texel down.
        mask: (H, W) bool, texels of the surface.
        texel_mm: (H, W) side of a texel on the surface, > 0 within the mask.
        start: (H, W) heights in mm by least squares.
    """
    height = start
    # A fixed scale: residuals of the equations that are kept shrink with each round, and a scale that followed them
    # would end up cutting noise.
    scale = _scale(_residuals(height, right, down, texel_mm), mask)
    done = 0
    while done < ROUNDS:
        edges = _weights(_residuals(height, right, down, texel_mm), scale)
        solved = integrate(right, down, mask, edges=edges, start=height).height
        change = float(np.abs(solved - height).max(initial=0.0))
        height = solved
        done += 1
        if change < SETTLED_MM:
            break
    asked = sum(int(joined(mask, axis).sum()) for axis in (1, 0))
    cut = sum(int((part < CUT)[joined(mask, axis)].sum()) for part, axis in ((edges.right, 1), (edges.down, 0)))
    return Robust(height, done, cut / asked if asked else 0.0)


def cliff_part(right: Float32, down: Float32, mask: Bool, texel_mm: Float32) -> tuple[Float32, float]:
    """Difference (H, W) in mm of robust to plain least-squares heights, and the share of equations given up.

    Args:
        right: (H, W) float32 change of height in mm per texel to the right.
        down: the same per texel down.
        mask: (H, W) bool, texels of the surface.
        texel_mm: (h, w) side of a texel of the (H, W) map, on the same chart at any size.
    """
    import cv2

    tall, wide = mask.shape
    factor = max(wide / WIDTH, 1.0)
    size = (round(wide / factor), round(tall / factor))
    weight = _shrunk(mask.astype(np.float32), size)
    known = weight > 0.5
    mean = np.where(known, np.float32(factor) / np.maximum(weight, 0.5), 0)
    mm = _shrunk(texel_mm, size) * np.float32(factor)
    known &= mm > 0
    coarse_right, coarse_down = (
        np.asarray(_shrunk(np.where(mask, slope, 0), size) * mean, np.float32) for slope in (right, down)
    )
    plain = integrate(coarse_right, coarse_down, known).height
    found = integrate_robustly(coarse_right, coarse_down, known, mm, plain)
    difference = found.height - plain
    _pad(difference, known)
    full = difference if size == (wide, tall) else cv2.resize(difference, (wide, tall), interpolation=cv2.INTER_LINEAR)
    return np.asarray(full * mask, np.float32), found.cut


def _residuals(height: Float32, right: Float32, down: Float32, texel_mm: Float32) -> tuple[Float32, Float32]:
    """Absolute residuals, as slopes, of the equations between neighbours to the right, and of those down."""
    found = []
    for slope, axis in ((right, 1), (down, 0)):
        mm = np.maximum(wanted(texel_mm, axis), np.float32(1e-6))
        found.append(np.asarray(np.abs(differences(height, axis) - wanted(slope, axis)) / mm, np.float32))
    return found[0], found[1]


def _scale(residuals: tuple[Float32, Float32], mask: Bool) -> np.float32:
    """Residual, as a slope, beyond which an equation loses weight."""
    inside = np.concatenate([part[joined(mask, axis)] for part, axis in zip(residuals, (1, 0), strict=True)])
    sigma = float(np.median(inside)) / _NORMAL_MEDIAN if len(inside) else 0.0
    return np.float32(max(NOISE * sigma, LEAST_SCALE))


def _weights(residuals: tuple[Float32, Float32], scale: np.float32) -> Edges:
    """Geman-McClure weight of each equation."""
    # Clipped, as the square would overflow; the weight is at its minimum long before.
    ratios = (np.minimum(part / scale, 1e6) for part in residuals)
    parts = (np.maximum(1 / np.square(1 + np.square(ratio)), LEAST_WEIGHT) for ratio in ratios)
    return Edges(*(np.asarray(part, np.float32) for part in parts))


def _shrunk(values: Float32, size: tuple[int, int]) -> Float32:
    """(h, w) values at a size (width, height), by area where that is smaller, else linearly."""
    import cv2

    if values.shape[::-1] == size:
        return np.asarray(values, np.float32)
    way = cv2.INTER_AREA if size[0] <= values.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.asarray(values, np.float32), size, interpolation=way))


def _pad(values: Float32, known: Bool) -> None:
    """Set texels adjacent to known ones to the mean of those, in place, so that interpolation meets no edge."""
    import cv2

    def around(plane: Float32) -> Float32:
        return np.asarray(cv2.boxFilter(plane, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT))

    count = around(known.astype(np.float32))
    near = ~known & (count > 0.5)
    values[near] = around(values * known)[near] / count[near]
