"""Damped least squares (Levenberg-Marquardt) with box bounds.

Nielsen's damping rule: a good step shrinks the damping smoothly, a bad one grows it ever faster (K. Madsen, H. B.
Nielsen, O. Tingleff, Methods for Non-Linear Least Squares Problems, 2004, section 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float64
from service.face.fit.state import State
from service.face.fit.terms import Term, energy, linearise


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
