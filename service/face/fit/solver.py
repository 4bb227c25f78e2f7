"""The fit's energy as a sum of terms, and damped least squares (Levenberg-Marquardt) with box bounds that minimises it.

A term returns half its sum of squares and adds J^T J and J^T r in place; ``energy`` and ``linearise`` sum over terms.
Nielsen's damping rule: a good step shrinks the damping smoothly, a bad one grows it ever faster (K. Madsen, H. B.
Nielsen, O. Tingleff, Methods for Non-Linear Least Squares Problems, 2004, section 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from service.arrays import Bool, Float64
from service.face.fit.pose_state import POSE, State, motion, pixel_jacobian, project_points


class Term(Protocol):
    """One addend of the energy."""

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""


@dataclass(frozen=True)
class PointTerm:
    """Reprojection error of points.

    Attributes:
        mean, modes: (N, 3) and (M, N, 3) metres, the points as a linear function of the coefficients.
        target: (N, 2) pixels relative to the principal point.
        precision: (N,) 1 / px^2, weights included.
        normal: (N, 2) unit vectors if only the distance along them counts (points on a contour), else None.
    """

    mean: Float64
    modes: Float64
    target: Float64
    precision: Float64
    normal: Float64 | None = None

    def _points(self, state: State) -> Float64:
        return np.asarray(self.mean + np.tensordot(state.coefficients, self.modes, 1))

    def _residual(self, uv: Float64) -> Float64:
        r = uv - self.target
        return r if self.normal is None else np.asarray((r * self.normal).sum(1, keepdims=True))

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        r = self._residual(project_points(state, self._points(state)).uv)
        return 0.5 * float((self.precision[:, None] * r**2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        projection = project_points(state, self._points(state))
        jacobian = pixel_jacobian(state, projection, motion(state, projection, self.modes))
        if self.normal is not None:
            jacobian = (jacobian * self.normal[:, :, None]).sum(1, keepdims=True)
        root = np.sqrt(self.precision)[:, None]
        j = (jacobian * root[:, :, None]).reshape(-1, len(gradient))
        hessian += j.T @ j
        gradient += j.T @ (self._residual(projection.uv) * root).ravel()


@dataclass(frozen=True)
class Prior:
    """Gaussian prior on log distance, log focal length and the shape coefficients.

    Attributes:
        log_distance, log_distance_sigma: metres.
        log_focal, log_focal_sigma: pixels.
        shape_precision: (K + E,) one over variance.
        shape_mean: (K + E,) coefficients that are most likely.
    """

    log_distance: float
    log_distance_sigma: float
    log_focal: float
    log_focal_sigma: float
    shape_precision: Float64
    shape_mean: Float64

    def _offsets(self, state: State) -> tuple[float, float]:
        a = (state.log_distance - self.log_distance) / self.log_distance_sigma
        b = (state.log_scale + state.log_distance - self.log_focal) / self.log_focal_sigma
        return a, b

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        a, b = self._offsets(state)
        off = state.coefficients - self.shape_mean
        return 0.5 * float(a**2 + b**2 + (self.shape_precision * off**2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        a, b = self._offsets(state)
        rows = np.zeros((2, len(gradient)))
        rows[0, 6] = 1 / self.log_distance_sigma
        rows[1, 5] = rows[1, 6] = 1 / self.log_focal_sigma
        hessian += rows.T @ rows
        gradient += rows.T @ np.array([a, b])
        index = np.arange(POSE, len(gradient))
        hessian[index, index] += self.shape_precision
        gradient[POSE:] += self.shape_precision * (state.coefficients - self.shape_mean)


def energy(terms: Sequence[Term], state: State) -> float:
    """The sum of the terms at a state."""
    return sum(term.cost(state) for term in terms)


def linearise(terms: Sequence[Term], state: State) -> tuple[Float64, Float64]:
    """J^T J (n, n) and J^T r (n,) of all terms at a state, by a step as :meth:`State.stepped` takes it."""
    n = POSE + len(state.coefficients)
    hessian, gradient = np.zeros((n, n)), np.zeros(n)
    for term in terms:
        term.add(state, hessian, gradient)
    return hessian, gradient


@dataclass
class Damping:
    """Damping kept between calls, so that a solve can be resumed after the weights changed."""

    mu: float = 1e-3
    nu: float = 2.0


def solve_step(hessian: Float64, gradient: Float64, mu: float, free: Bool) -> Float64:
    """The damped Gauss-Newton step over the free variables; zero for the others.

    Marquardt's scaling by the diagonal, floored so that a variable that no residual sees stays put instead of
    making the system singular.

    Args:
        hessian: (n, n) J^T J.
        gradient: (n,) J^T r.
        mu: damping > 0.
        free: (n,) variables that may move.

    Returns:
        (n,) step, finite: where the factorisation fails, the minimum-norm solution; zero if that is not finite.
    """
    step = np.zeros_like(gradient)
    index = np.flatnonzero(free)
    if index.size == 0:
        return step
    h = hessian[np.ix_(index, index)]
    diagonal = np.maximum(np.diag(h), 1e-6)
    damped = h + np.diag(mu * diagonal)
    try:
        factor = np.linalg.cholesky(damped)
        part = -np.linalg.solve(factor.T, np.linalg.solve(factor, gradient[index]))
    except np.linalg.LinAlgError:
        if not np.isfinite(damped).all():
            return step
        part = -np.linalg.lstsq(damped, gradient[index], rcond=1e-12)[0]
    if np.isfinite(part).all():
        step[index] = part
    return step


def minimise(
    state: State,
    terms: Sequence[Term],
    *,
    lower: Float64,
    upper: Float64,
    damping: Damping,
    steps: int,
    active: Bool,
    tolerance: float = 1e-6,
) -> State:
    """Take up to ``steps`` damped steps; the energy never rises.

    Args:
        state: start, finite, inside the bounds.
        terms: addends of the energy.
        lower: (n,) least value of each unknown, minus infinity where there is none.
        upper: (n,) greatest value, infinity where there is none.
        damping: updated in place.
        steps: how many steps to try at most.
        active: (n,) unknowns that may move.
        tolerance: stop when no unknown moves by more.

    Returns:
        The best state seen.
    """
    value = energy(terms, state)
    hessian, gradient = linearise(terms, state)
    for _ in range(steps):
        x = state.unknowns()
        stuck = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        step = np.clip(x + solve_step(hessian, gradient, damping.mu, active & ~stuck), lower, upper) - x
        if not np.abs(step).max(initial=0.0) > tolerance:
            break
        candidate = state.stepped(step)
        new_value = energy(terms, candidate)
        expected = -float(step @ gradient) - 0.5 * float(step @ hessian @ step)
        if np.isfinite(new_value) and new_value < value:
            gain = min((value - new_value) / expected, 1.0) if expected > 0 else 0.0
            damping.mu = max(damping.mu * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-9)
            damping.nu = 2.0
            state, value = candidate, new_value
            hessian, gradient = linearise(terms, state)
        else:
            damping.mu = min(damping.mu * damping.nu, 1e12)
            damping.nu = min(2.0 * damping.nu, 1e6)
    return state
