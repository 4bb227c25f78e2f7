"""Heights from their slopes: (weighted) least squares on a masked grid.

The heights whose differences between neighbouring texels come nearest to the wanted ones solve a Poisson equation. At
the border of the mask nothing is asked (natural Neumann conditions). Conjugate gradients solve it, preconditioned with
the exact solution on the full rectangle, which two cosine transforms give (Simchony, Chellappa, Shao 1990). A Fourier
transform instead would take the map for periodic and turn any overall slope into waves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

TOLERANCE = 3e-3
"""Share of the first residual, in the energy norm, at which the solver stops: a thousandth of the relief or less."""

MOST_STEPS = 12


@dataclass(frozen=True)
class Heights:
    """Solution (H, W) float32, 0 outside the mask, of mean 0 over it; steps taken and residual left (relative)."""

    height: Float
    steps: int
    residual: float


@dataclass(frozen=True)
class Edges:
    """Weights >= 0 of the equations between neighbours: ``right`` (H, W - 1) and ``down`` (H - 1, W), float32."""

    right: Float
    down: Float


def integrate(
    right: Float,
    down: Float,
    mask: Mask,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    edges: Edges | None = None,
    start: Float | None = None,
) -> Heights:
    """Heights on a grid from their slopes.

    Args:
        right: (H, W) float32 change of height per texel to the right, finite; only read where ``mask`` is True.
        down: the same per texel down.
        mask: (H, W) bool; a texel that is False takes part in no equation. Regions that do not touch are independent,
            and each keeps an unknown constant, which is set so that the mean over all is 0.
        tolerance: relative residual to stop at.
        most_steps: to take at most.
        edges: weights of the equations; None: all 1.
        start: (H, W) heights, 0 outside the mask, to begin with; None: all 0.

    Raises:
        ValueError: the shapes differ.
    """
    sources = divergence(right, down, mask, edges)
    return solve(sources, mask, tolerance=tolerance, most_steps=most_steps, edges=edges, start=start)


def solve(
    rest: Float,
    mask: Mask,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    edges: Edges | None = None,
    start: Float | None = None,
) -> Heights:
    """Heights from what :func:`divergence` made of slopes, which is overwritten: callers of large maps need no slopes.

    The other arguments are those of :func:`integrate`.
    """
    height = np.zeros(mask.shape, np.float32)
    first = _dot(rest, rest)
    if not first > 0:
        return Heights(height, 0, 0.0)
    precondition = _Rectangle(mask)
    step = precondition(rest)
    energy = whole = _dot(rest, step)
    if start is not None:
        height += start
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
    return Heights(height, taken, float(np.sqrt(max(energy, 0.0) / whole)))


def differences(height: Float, axis: int) -> Float:
    """Height of the next texel along ``axis`` (1: right, 0: down) minus that of each that has one."""
    near, far = _halves(axis)
    return np.asarray(height[far] - height[near], np.float32)


def wanted(slope: Float, axis: int) -> Float:
    """Differences that slopes ask for, averaged to the middle of the edge: one-sided, they shift by half a texel."""
    near, far = _halves(axis)
    return np.asarray(0.5 * (slope[near] + slope[far]), np.float32)


def joined(mask: Mask, axis: int) -> Mask:
    """Which texels and their next ones along ``axis`` are both in the mask."""
    near, far = _halves(axis)
    return np.asarray(mask[near] & mask[far])


def divergence(right: Float, down: Float, mask: Mask, edges: Edges | None = None) -> Float:
    """(H, W) for each texel: wanted differences of the edges that come in, minus those that go out.

    Raises:
        ValueError: the shapes differ.
    """
    if not right.shape == down.shape == mask.shape or right.ndim != 2:
        raise ValueError(f"slopes {right.shape} and {down.shape} and mask {mask.shape} have to be of one shape")
    result = np.zeros(mask.shape, np.float32)
    for slope, axis in ((right, 1), (down, 0)):
        edge = wanted(slope, axis)
        edge[~joined(mask, axis)] = 0  # not a product: outside the mask a slope may be anything
        _add_edges(result, edge, edges, axis)
    return result


def _laplacian(height: Float, mask: Mask, edges: Edges | None) -> Float:
    """(H, W) for each texel of the mask: sum over its neighbours in the mask of its height minus theirs."""
    result = np.zeros_like(height)
    for axis in (1, 0):
        edge = differences(height, axis)
        edge *= joined(mask, axis)
        _add_edges(result, edge, edges, axis)
    return result


def _add_edges(result: Float, edge: Float, edges: Edges | None, axis: int) -> None:
    """Add a quantity of each edge, times its weight, to the texel that it leads to; take it from the other one."""
    near, far = _halves(axis)
    if edges is not None:
        edge *= edges.right if axis == 1 else edges.down
    result[far] += edge
    result[near] -= edge


def _halves(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of the texels that have a next one along ``axis``, and of those next ones."""
    near, far = [slice(None)] * 2, [slice(None)] * 2
    near[axis], far[axis] = slice(None, -1), slice(1, None)
    return tuple(near), tuple(far)


class _Rectangle:
    """Solves the equation on the whole rectangle, for right-hand sides that are 0 outside the mask."""

    def __init__(self, mask: Mask) -> None:
        self._mask = mask
        self._box = (_span(np.asarray(mask.any(1))), _span(np.asarray(mask.any(0))))
        tall, wide = (part.stop - part.start for part in self._box)
        self._down = (2 - 2 * np.cos(np.pi * np.arange(tall) / tall)).astype(np.float32)
        self._across = (2 - 2 * np.cos(np.pi * np.arange(wide) / wide)).astype(np.float32)

    def __call__(self, rest: Float) -> Float:
        from scipy.fft import dctn, idctn

        waves = dctn(rest[self._box], norm="ortho", workers=2)
        for index, row in enumerate(self._down):
            frequency = self._across + row
            if index == 0:
                frequency[0] = np.inf  # the mean has no equation
            waves[index] /= frequency
        waves = idctn(waves, norm="ortho", workers=2, overwrite_x=True)
        if waves.shape == rest.shape:
            result = np.asarray(waves, np.float32)
        else:
            result = np.zeros_like(rest)
            result[self._box] = waves
        result *= self._mask
        return result


def _span(occupied: npt.NDArray[np.bool_]) -> slice:
    where = np.flatnonzero(occupied)
    return slice(int(where[0]), int(where[-1]) + 1)


def _dot(a: Float, b: Float) -> float:
    """Sum of products; each row in float32, rows in float64."""
    return float(np.einsum("yx,yx->y", a, b).sum(dtype=np.float64))
