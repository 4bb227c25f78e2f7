"""Heights from their slopes: least squares on a masked grid.

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


def integrate(
    right: Float, down: Float, mask: Mask, *, tolerance: float = TOLERANCE, most_steps: int = MOST_STEPS
) -> Heights:
    """Heights on a grid from their slopes.

    Args:
        right: (H, W) float32 change of height per texel to the right, finite; only read where ``mask`` is True.
        down: the same per texel down.
        mask: (H, W) bool; a texel that is False takes part in no equation. Regions that do not touch are independent,
            and each keeps an unknown constant, which is set so that the mean over all is 0.
        tolerance: relative residual to stop at.
        most_steps: to take at most.

    Raises:
        ValueError: the shapes differ.
    """
    if not right.shape == down.shape == mask.shape or right.ndim != 2:
        raise ValueError(f"slopes {right.shape} and {down.shape} and mask {mask.shape} have to be of one shape")
    height = np.zeros(mask.shape, np.float32)
    rest = _right_hand_side(right, down, mask)
    first = _dot(rest, rest)
    if not first > 0:
        return Heights(height, 0, 0.0)
    precondition = _Rectangle(mask)
    step = precondition(rest)
    search = step
    energy = start = _dot(rest, step)
    taken = 0
    while taken < most_steps and energy > tolerance * tolerance * start and energy > 0:
        applied = _laplacian(search, mask)
        curvature = _dot(search, applied)
        if not curvature > 0:
            break
        length = np.float32(energy / curvature)
        height += length * search
        applied *= length
        rest -= applied
        del applied
        step = precondition(rest)
        following = _dot(rest, step)
        search *= np.float32(following / energy)
        search += step
        energy = following
        taken += 1
    height -= np.float32(height.sum(dtype=np.float64) / max(int(mask.sum()), 1))
    height *= mask
    return Heights(height, taken, float(np.sqrt(max(energy, 0.0) / start)))


def _right_hand_side(right: Float, down: Float, mask: Mask) -> Float:
    """(H, W) for each texel: wanted differences of the edges that come in, minus those that go out."""
    result = np.zeros(mask.shape, np.float32)
    for slope, axis in ((right, 1), (down, 0)):
        near, far = _halves(axis)
        # Slopes averaged to the middle of the edge: one-sided ones shift the surface by half a texel.
        edge = 0.5 * (slope[near] + slope[far]) * (mask[near] & mask[far])
        edge = np.asarray(np.where(mask[near] & mask[far], edge, 0), np.float32)
        result[far] += edge
        result[near] -= edge
    return result


def _laplacian(height: Float, mask: Mask) -> Float:
    """(H, W) for each texel of the mask: sum over its neighbours in the mask of its height minus theirs."""
    result = np.zeros_like(height)
    for axis in (1, 0):
        near, far = _halves(axis)
        edge = (height[far] - height[near]) * (mask[near] & mask[far])
        result[far] += edge
        result[near] -= edge
    return result


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
        result = np.zeros_like(rest)
        result[self._box] = idctn(waves, norm="ortho", workers=2, overwrite_x=True)
        result *= self._mask
        return result


def _span(occupied: npt.NDArray[np.bool_]) -> slice:
    where = np.flatnonzero(occupied)
    return slice(int(where[0]), int(where[-1]) + 1)


def _dot(a: Float, b: Float) -> float:
    """Sum of products; each row in float32, rows in float64."""
    return float(np.einsum("yx,yx->y", a, b).sum(dtype=np.float64))
