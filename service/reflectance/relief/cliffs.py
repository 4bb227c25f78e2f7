"""Integration that keeps cliffs: where the surface is torn or folds over itself, as at a nostril or between the lips.

There the slopes of neighbouring texels belong to no common surface. Least squares spreads the contradiction over a
region as wide as the cliff is long. Here each equation between neighbours is weighted by how well it can be met
(Geman-McClure, iteratively reweighted least squares: Agrawal, Raskar, Chellappa 2006, section 5; Queau, Durou, Aujol
2018, section 4), so that a few equations on the cliff give way and all others are met. The weights of bilateral normal
integration (Cao et al. 2022), which compare the equations at both sides of a texel, do nothing at this scale: a cliff
of a millimetre is a few texels high, and both sides are off alike.

That is done on a map at most ``WIDTH`` texels wide; what it changes is added to the full map's least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.reflectance.relief.integrate import Edges, Float, Mask, differences, integrate, joined, wanted

WIDTH = 1536

ROUNDS = 24
SETTLED_MM = 2e-4
"""Stop when no height changes by more in a round."""

LEAST_SCALE = 0.05
"""Slope that an equation may be off without losing weight; or ``NOISE`` times what they are usually off, if more."""

NOISE = 3.5
LEAST_WEIGHT = 1e-3
CUT = 0.25
"""An equation with less weight counts as given up."""

_NORMAL_MEDIAN = 0.6745


@dataclass(frozen=True)
class Robust:
    """Heights (H, W) float32 in mm of mean 0 over the mask, rounds taken, and the share of equations given up."""

    height: Float
    rounds: int
    cut: float


def integrate_robustly(right: Float, down: Float, mask: Mask, texel_mm: Float, start: Float) -> Robust:
    """Heights from slopes with few equations between neighbours given up.

    Args:
        right: (H, W) float32 change of height in mm per texel to the right.
        down: the same per texel down.
        mask: (H, W) bool, texels that take part.
        texel_mm: (H, W) side of a texel on the surface, > 0 within the mask.
        start: (H, W) the solution of least squares.
    """
    height = start
    # The scale stays: with each round those that are kept are met better, and a scale that followed would cut noise.
    scale = _scale(_off(height, right, down, texel_mm), mask)
    done = 0
    while done < ROUNDS:
        edges = _weights(_off(height, right, down, texel_mm), scale)
        solved = integrate(right, down, mask, edges=edges, start=height).height
        change = float(np.abs(solved - height).max(initial=0.0))
        height = solved
        done += 1
        if change < SETTLED_MM:
            break
    asked = sum(int(joined(mask, axis).sum()) for axis in (1, 0))
    cut = sum(int((part < CUT)[joined(mask, axis)].sum()) for part, axis in ((edges.right, 1), (edges.down, 0)))
    return Robust(height, done, cut / asked if asked else 0.0)


def cliff_part(right: Float, down: Float, mask: Mask, texel_mm: Float) -> tuple[Float, float]:
    """What keeping cliffs changes about the heights (H, W) in mm of least squares, and the share of equations given up.

    Args:
        right: (H, W) float32 change of height in mm per texel to the right.
        down: the same per texel down.
        mask: (H, W) bool, texels that take part.
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
    gained = found.height - plain
    _continue(gained, known)
    full = gained if size == (wide, tall) else cv2.resize(gained, (wide, tall), interpolation=cv2.INTER_LINEAR)
    return np.asarray(full * mask, np.float32), found.cut


def _off(height: Float, right: Float, down: Float, texel_mm: Float) -> tuple[Float, Float]:
    """How far each equation's two heights are from what it asks for, as a slope: to the right, and down."""
    found = []
    for slope, axis in ((right, 1), (down, 0)):
        mm = np.maximum(wanted(texel_mm, axis), np.float32(1e-6))
        found.append(np.asarray(np.abs(differences(height, axis) - wanted(slope, axis)) / mm, np.float32))
    return found[0], found[1]


def _scale(off: tuple[Float, Float], mask: Mask) -> np.float32:
    """What an equation may be off without losing weight."""
    asked = np.concatenate([part[joined(mask, axis)] for part, axis in zip(off, (1, 0), strict=True)])
    usual = float(np.median(asked)) / _NORMAL_MEDIAN if len(asked) else 0.0
    return np.float32(max(NOISE * usual, LEAST_SCALE))


def _weights(off: tuple[Float, Float], scale: np.float32) -> Edges:
    """Weight of each equation."""
    # Beyond 1e6 times the scale the square would overflow; the weight is at its least long before.
    parts = (np.maximum(1 / np.square(1 + np.square(np.minimum(part / scale, 1e6))), LEAST_WEIGHT) for part in off)
    return Edges(*(np.asarray(part, np.float32) for part in parts))


def _shrunk(values: Float, size: tuple[int, int]) -> Float:
    import cv2

    if values.shape[::-1] == size:
        return np.asarray(values, np.float32)
    way = cv2.INTER_AREA if size[0] <= values.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.asarray(values, np.float32), size, interpolation=way))


def _continue(values: Float, known: Mask) -> None:
    """Give texels next to known ones the mean of those, in place, so that interpolation meets no edge."""
    import cv2

    def around(plane: Float) -> npt.NDArray[np.float32]:
        return np.asarray(cv2.boxFilter(plane, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT))

    count = around(known.astype(np.float32))
    near = ~known & (count > 0.5)
    values[near] = around(values * known)[near] / count[near]
