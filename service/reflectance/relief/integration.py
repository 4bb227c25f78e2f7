"""Heights from slopes by least squares on a masked grid.

The heights whose differences between neighbouring texels best match the slopes solve a Poisson equation, with natural
(Neumann) conditions at the border of the mask. It is solved by conjugate gradients, preconditioned with the exact
solution on the full rectangle by two cosine transforms (Simchony, Chellappa, Shao 1990). A Fourier transform would
treat the map as periodic and turn any overall slope into waves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32
from service.image_filters import by_strips

TOLERANCE = 4.5e-3
"""Relative residual, in the norm of the preconditioner, from which on the solver takes one more step, the last. What
that leaves, about 0.6 of it, is not measured: that would take two cosine transforms, a quarter of the time."""

MOST_STEPS = 12
"""Most steps of conjugate gradients."""


@dataclass(frozen=True)
class Heights:
    """Heights (H, W) float32, 0 outside the mask, of mean 0 over it; steps taken; relative residual before the last."""

    height: Float32
    steps: int
    residual: float


def solve(
    rest: Float32,
    mask: Bool,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
) -> Heights:
    """Heights from the result of :func:`divergence`, so that callers of large maps can free the slopes first.

    Args:
        rest: (H, W) float32 right-hand side; overwritten.
        mask: (H, W) bool; a texel that is False is in no equation. Regions that do not touch are independent, and the
            constant of each is undetermined; the mean over all is set to 0.
        tolerance: relative residual from which on a step is the last.
        most_steps: of conjugate gradients.
    """
    whole_height = np.zeros(mask.shape, np.float32)
    if not _dot(rest, rest) > 0:
        return Heights(whole_height, 0, 0.0)
    box = (_span(np.asarray(mask.any(1))), _span(np.asarray(mask.any(0))))
    rest, mask, height = rest[box], mask[box], whole_height[box]  # views
    precondition = _Rectangle(mask)
    step = precondition(rest)
    energy = whole = _dot(rest, step)
    search = step
    del step
    taken = 0
    while taken < most_steps and energy > 0:
        applied = _laplacian(search, mask)
        curvature = _dot(search, applied)
        if not curvature > 0:
            break
        length = np.float32(energy / curvature)
        applied *= length
        rest -= applied
        np.multiply(search, length, out=applied)
        height += applied
        del applied
        taken += 1
        if energy <= tolerance * tolerance * whole:
            break
        step = precondition(rest)
        following = _dot(rest, step)
        search *= np.float32(following / energy)
        search += step
        del step
        energy = following
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


def divergence(right: Float32, down: Float32, mask: Bool) -> Float32:
    """(H, W) right-hand side: for each texel, wanted differences of its incoming edges minus those of outgoing ones.

    Args:
        right: (H, W) float32 change of height per texel to the right, finite; only read where ``mask`` is True.
        down: the same per texel down.
        mask: as of :func:`solve`.
    """

    def edge(axis: int, rows: slice) -> Float32:
        values = wanted((right if axis == 1 else down)[rows], axis)
        values[~joined(mask[rows], axis)] = 0  # assigned, as slopes outside the mask may be NaN
        return values

    return _gathered(mask.shape, edge)


def _laplacian(height: Float32, mask: Bool) -> Float32:
    """(H, W) for each texel of the mask: its height minus that of each neighbour in the mask, summed."""

    def edge(axis: int, rows: slice) -> Float32:
        values = differences(height[rows], axis)
        values *= joined(mask[rows], axis)
        return values

    return _gathered(mask.shape, edge)


def _gathered(shape: tuple[int, ...], edge: Callable[[int, slice], Float32]) -> Float32:
    """(H, W) for each texel: values of its incoming edges minus those of its outgoing ones.

    Args:
        shape: of the map.
        edge: axis and rows of texels -> values of the edges between these.
    """
    result = np.zeros(shape, np.float32)

    def gather(rows: slice) -> None:
        part, start = result[rows], rows.start
        across = edge(1, rows)
        part[:, 1:] += across
        part[:, :-1] -= across
        first, last = max(start - 1, 0), min(rows.stop, shape[0] - 1)  # edges from each of these rows to the next
        if last > first:
            down = edge(0, slice(first, last + 1))
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
    """From the first to the last True, and on to a length at which cosine transforms take a quarter of the time."""
    from scipy.fft import next_fast_len

    where = np.flatnonzero(occupied)
    first, length = int(where[0]), int(where[-1] - where[0]) + 1
    length = min(next_fast_len(length, real=True), len(occupied))
    first = min(first, len(occupied) - length)
    return slice(first, first + length)


def _dot(a: Float32, b: Float32) -> float:
    """Dot product of maps: in float32 along rows, in float64 over rows."""
    return float(np.einsum("yx,yx->y", a, b).sum(dtype=np.float64))
