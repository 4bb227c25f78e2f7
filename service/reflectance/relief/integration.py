"""Heights from slopes by (weighted) least squares on a masked grid.

The heights whose differences between neighbouring texels best match the slopes solve a Poisson equation, with natural
(Neumann) conditions at the border of the mask. It is solved by conjugate gradients, preconditioned with the exact
solution on the full rectangle by two cosine transforms (Simchony, Chellappa, Shao 1990). A Fourier transform would
treat the map as periodic and turn any overall slope into waves.

Robust integration keeps cliffs: depth discontinuities, as at a nostril or between the lips. The slopes of neighbouring
texels across a cliff belong to no common surface, and least squares spreads the contradiction over a region as wide as
the cliff is long. Here each equation between neighbours is weighted by its residual (Geman-McClure, iteratively
reweighted least squares: Agrawal, Raskar, Chellappa 2006, section 5; Queau, Durou, Aujol 2018, section 4), so that a
few equations on the cliff are given up and all others are met. The weights of bilateral normal integration (Cao et al.
2022), which compare the residuals at both sides of a texel, do not help at this scale: a cliff of a millimetre spans a
few texels, and the residuals at both sides are alike.

This is done on a map at most ``WIDTH`` texels wide; its difference to least squares is added to the full map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Bool, Float32
from service.image_filters import by_strips, resized

TOLERANCE = 3e-3
"""Relative residual, in the norm of the preconditioner, at which the solver stops: errors are at most a thousandth of
the relief."""

MOST_STEPS = 12
"""Most steps of conjugate gradients."""


@dataclass(frozen=True)
class Heights:
    """Heights (H, W) float32, 0 outside the mask, of mean 0 over it; steps taken; and the relative residual."""

    height: Float32
    steps: int
    residual: float


@dataclass(frozen=True)
class Edges:
    """Weights >= 0 of the equations between neighbours: ``right`` (H, W - 1) and ``down`` (H - 1, W), float32."""

    right: Float32
    down: Float32

    def within(self, rows: slice, columns: slice) -> Edges:
        """Weights of the edges between texels of a rectangle, as views."""
        inner_rows, inner_columns = (slice(one.start, one.stop - 1) for one in (rows, columns))
        return Edges(self.right[rows, inner_columns], self.down[inner_rows, columns])


def integrate(
    right: Float32,
    down: Float32,
    mask: Bool,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    edges: Edges | None = None,
    start: Float32 | None = None,
) -> Heights:
    """Heights on a grid from slopes.

    Args:
        right: (H, W) float32 change of height per texel to the right, finite; only read where ``mask`` is True.
        down: the same per texel down.
        mask: (H, W) bool; a texel that is False is in no equation. Regions that do not touch are independent, and the
            constant of each is undetermined; the mean over all is set to 0.
        tolerance: relative residual to stop at.
        most_steps: of conjugate gradients.
        edges: weights of the equations; None: all 1.
        start: (H, W) initial heights, 0 outside the mask; None: all 0.

    Raises:
        ValueError: the shapes differ.
    """
    sources = divergence(right, down, mask, edges)
    return solve(sources, mask, tolerance=tolerance, most_steps=most_steps, edges=edges, start=start)


def solve(
    rest: Float32,
    mask: Bool,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    edges: Edges | None = None,
    start: Float32 | None = None,
) -> Heights:
    """Heights from the result of :func:`divergence`, so that callers of large maps can free the slopes first.

    Args:
        rest: (H, W) float32 right-hand side; overwritten.
        mask: as of :func:`integrate`, like the arguments that follow.
        tolerance: see there.
        most_steps: see there.
        edges: see there.
        start: see there.
    """
    whole_height = np.zeros(mask.shape, np.float32)
    if not _dot(rest, rest) > 0:
        return Heights(whole_height, 0, 0.0)
    box = (_span(np.asarray(mask.any(1))), _span(np.asarray(mask.any(0))))
    rest, mask, height = rest[box], mask[box], whole_height[box]  # views
    edges = None if edges is None else edges.within(*box)
    precondition = _Rectangle(mask)
    step = precondition(rest)
    energy = whole = _dot(rest, step)
    if start is not None:
        height += start[box]
        rest -= _laplacian(height, mask, edges)
        step = precondition(rest)
        energy = _dot(rest, step)
    search = step
    del step
    taken = 0
    while taken < most_steps and energy > tolerance * tolerance * whole and energy > 0:
        applied = _laplacian(search, mask, edges)
        curvature = _dot(search, applied)
        if not curvature > 0:
            break
        length = np.float32(energy / curvature)
        applied *= length
        rest -= applied
        np.multiply(search, length, out=applied)
        height += applied
        del applied
        step = precondition(rest)
        following = _dot(rest, step)
        search *= np.float32(following / energy)
        search += step
        del step
        energy = following
        taken += 1
    height -= np.float32(height.sum(dtype=np.float64) / max(int(mask.sum()), 1))
    height *= mask
    return Heights(whole_height, taken, float(np.sqrt(max(energy, 0.0) / whole)))


def differences(height: Float32, axis: int) -> Float32:
    """Differences of neighbouring heights along ``axis`` (1: to the right, 0: down), one fewer than texels."""
    near, far = _halves(axis)
    return np.asarray(height[far] - height[near], np.float32)


def wanted(slope: Float32, axis: int) -> Float32:
    """Differences of neighbours by their slopes' mean: the slope of one of them would shift heights by half a texel."""
    near, far = _halves(axis)
    return np.asarray(0.5 * (slope[near] + slope[far]), np.float32)


def joined(mask: Bool, axis: int) -> Bool:
    """Whether neighbours along ``axis`` are both in the mask."""
    near, far = _halves(axis)
    return np.asarray(mask[near] & mask[far])


def divergence(right: Float32, down: Float32, mask: Bool, edges: Edges | None = None) -> Float32:
    """(H, W) right-hand side: for each texel, wanted differences of its incoming edges minus those of outgoing ones.

    Raises:
        ValueError: the shapes differ.
    """
    if not right.shape == down.shape == mask.shape or right.ndim != 2:
        raise ValueError(f"slopes {right.shape} and {down.shape} and mask {mask.shape} have to be of one shape")

    def edge(axis: int, rows: slice, band: slice) -> Float32:
        values = wanted((right if axis == 1 else down)[rows], axis)
        values[~joined(mask[rows], axis)] = 0  # assigned, as slopes outside the mask may be NaN
        return _weighted(values, edges, axis, band)

    return _gathered(mask.shape, edge)


def _laplacian(height: Float32, mask: Bool, edges: Edges | None) -> Float32:
    """(H, W) for each texel of the mask: its height minus that of each neighbour in the mask, weighted and summed."""

    def edge(axis: int, rows: slice, band: slice) -> Float32:
        values = differences(height[rows], axis)
        values *= joined(mask[rows], axis)
        return _weighted(values, edges, axis, band)

    return _gathered(mask.shape, edge)


def _weighted(values: Float32, edges: Edges | None, axis: int, band: slice) -> Float32:
    if edges is not None:
        values *= (edges.right if axis == 1 else edges.down)[band]
    return values


def _gathered(shape: tuple[int, ...], edge: Callable[[int, slice, slice], Float32]) -> Float32:
    """(H, W) for each texel: values of its incoming edges minus those of its outgoing ones.

    Args:
        shape: of the map.
        edge: axis, rows of texels, and rows of the edges between these, -> values of those edges.
    """
    result = np.zeros(shape, np.float32)

    def gather(rows: slice) -> None:
        part, start = result[rows], rows.start
        across = edge(1, rows, rows)
        part[:, 1:] += across
        part[:, :-1] -= across
        first, last = max(start - 1, 0), min(rows.stop, shape[0] - 1)  # edges from each of these rows to the next
        if last > first:
            down = edge(0, slice(first, last + 1), slice(first, last))
            stop = min(rows.stop - 1, last)
            part[first + 1 - start : stop + 1 - start] += down[: stop - first]
            part[: last - start] -= down[start - first :]

    by_strips(shape[0], gather)
    return result


def _halves(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of the texels that have a next neighbour along ``axis``, and of those neighbours."""
    near, far = [slice(None)] * 2, [slice(None)] * 2
    near[axis], far[axis] = slice(None, -1), slice(1, None)
    return tuple(near), tuple(far)


class _Rectangle:
    """Preconditioner: solves the unweighted equation on the mask's rectangle by cosine transforms."""

    def __init__(self, mask: Bool) -> None:
        self._mask = mask
        tall, wide = mask.shape
        self._down = (2 - 2 * np.cos(np.pi * np.arange(tall) / tall)).astype(np.float32)
        self._across = (2 - 2 * np.cos(np.pi * np.arange(wide) / wide)).astype(np.float32)

    def __call__(self, rest: Float32) -> Float32:
        from scipy.fft import dctn, idctn

        waves = dctn(rest, norm="ortho", workers=2)

        def divide(rows: slice) -> None:
            frequency = self._down[rows, None] + self._across
            if rows.start == 0:
                frequency[0, 0] = np.inf  # the mean is undetermined: leave it 0
            waves[rows] /= frequency

        by_strips(len(waves), divide)
        result = np.asarray(idctn(waves, norm="ortho", workers=2, overwrite_x=True), np.float32)
        result *= self._mask
        return result


def _span(occupied: Bool) -> slice:
    """From the first to the last True."""
    where = np.flatnonzero(occupied)
    return slice(int(where[0]), int(where[-1]) + 1)


def _dot(a: Float32, b: Float32) -> float:
    """Dot product of maps: in float32 along rows, in float64 over rows."""
    return float(np.einsum("yx,yx->y", a, b).sum(dtype=np.float64))


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
    tall, wide = mask.shape
    factor = max(wide / WIDTH, 1.0)
    size = (round(wide / factor), round(tall / factor))
    weight = resized(mask.astype(np.float32), size)
    known = weight > 0.5
    mean = np.where(known, np.float32(factor) / np.maximum(weight, 0.5), 0)
    mm = resized(texel_mm, size) * np.float32(factor)
    known &= mm > 0
    coarse_right, coarse_down = (
        np.asarray(resized(np.where(mask, slope, 0), size) * mean, np.float32) for slope in (right, down)
    )
    plain = integrate(coarse_right, coarse_down, known).height
    found = integrate_robustly(coarse_right, coarse_down, known, mm, plain)
    difference = found.height - plain
    _pad(difference, known)
    full = resized(difference, (wide, tall))
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


def _pad(values: Float32, known: Bool) -> None:
    """Set texels adjacent to known ones to the mean of those, in place, so that interpolation meets no edge."""

    def around(plane: Float32) -> Float32:
        return np.asarray(cv2.boxFilter(plane, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT))

    count = around(known.astype(np.float32))
    near = ~known & (count > 0.5)
    values[near] = around(values * known)[near] / count[near]
