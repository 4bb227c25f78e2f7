"""Heights from slopes by (weighted) least squares on a masked grid.

The heights whose differences between neighbouring texels best match the slopes solve a Poisson equation, with natural
(Neumann) conditions at the border of the mask. It is solved by conjugate gradients, preconditioned with the exact
solution on the full rectangle by two cosine transforms (Simchony, Chellappa, Shao 1990). A Fourier transform would
treat the map as periodic and turn any overall slope into waves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32

TOLERANCE = 3e-3
"""Relative residual, in the norm of the preconditioner, at which the solver stops: errors are at most a thousandth of
the relief."""

MOST_STEPS = 12
"""Most steps of conjugate gradients."""

_BAND = 256
"""Rows of edges at a time, as a plane of them takes 100 MB at 6144 x 4096."""


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
        """Of the edges between texels of a rectangle, as views."""
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
    result = np.zeros(mask.shape, np.float32)
    for slope, axis in ((right, 1), (down, 0)):
        for rows, band in _bands(mask.shape[0], axis):
            edge = wanted(slope[rows], axis)
            edge[~joined(mask[rows], axis)] = 0  # assigned, as slopes outside the mask may be NaN
            _add_edges(result[rows], edge, edges, axis, band)
    return result


def _laplacian(height: Float32, mask: Bool, edges: Edges | None) -> Float32:
    """(H, W) for each texel of the mask: its height minus that of each neighbour in the mask, weighted and summed."""
    result = np.zeros_like(height)
    for axis in (1, 0):
        for rows, band in _bands(mask.shape[0], axis):
            edge = differences(height[rows], axis)
            edge *= joined(mask[rows], axis)
            _add_edges(result[rows], edge, edges, axis, band)
    return result


def _bands(height: int, axis: int) -> Iterator[tuple[slice, slice]]:
    """Rows of a map of ``height`` rows whose edges along ``axis`` are worked on together, and rows of these edges."""
    more = 1 if axis == 0 else 0
    for top in range(0, height - more, _BAND):
        bottom = min(top + _BAND, height - more)
        yield slice(top, bottom + more), slice(top, bottom)


def _add_edges(result: Float32, edge: Float32, edges: Edges | None, axis: int, band: slice) -> None:
    """Add a value of each edge, times the edge's weight, to its end texel, and subtract it from its start texel."""
    near, far = _halves(axis)
    if edges is not None:
        edge *= (edges.right if axis == 1 else edges.down)[band]
    result[far] += edge
    result[near] -= edge


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
        for index, row in enumerate(self._down):
            frequency = self._across + row
            if index == 0:
                frequency[0] = np.inf  # the mean is undetermined: leave it 0
            waves[index] /= frequency
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
