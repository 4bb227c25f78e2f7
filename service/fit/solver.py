"""Damped least squares (Levenberg-Marquardt) with box bounds.

Nielsen's damping rule: a good step shrinks the damping smoothly, a bad one grows it ever faster (K. Madsen, H. B.
Nielsen, O. Tingleff, Methods for Non-Linear Least Squares Problems, 2004, section 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

Linearise = Callable[[Array], tuple[Array, Array, float]]
"""x (n,) -> (J^T J (n, n), J^T r (n,), 0.5 |r|^2)."""

Cost = Callable[[Array], float]


@dataclass
class Damping:
    """State that survives between calls, so that a solve can go on after the weights changed."""

    mu: float = 1e-3
    nu: float = 2.0


def solve_step(hessian: Array, gradient: Array, mu: float, free: npt.NDArray[np.bool_]) -> Array:
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
    x: Array,
    linearise: Linearise,
    cost: Cost,
    *,
    lower: Array,
    upper: Array,
    damping: Damping,
    steps: int,
    active: npt.NDArray[np.bool_],
    tolerance: float = 1e-6,
) -> Array:
    """Take up to ``steps`` damped steps from x; the cost never rises.

    Args:
        x: (n,) start, finite, inside the bounds.
        linearise, cost: see the type aliases; cost must agree with linearise's third value.
        lower, upper: (n,) bounds, infinite where there are none.
        damping: updated in place.
        steps: how many linearisations at most.
        active: (n,) variables that may move.
        tolerance: stop when no variable moves by more.

    Returns:
        (n,) the best x seen.
    """
    hessian, gradient, value = linearise(x)
    for _ in range(steps):
        stuck = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        step = solve_step(hessian, gradient, damping.mu, active & ~stuck)
        candidate = np.clip(x + step, lower, upper)
        step = candidate - x
        if not np.abs(step).max(initial=0.0) > tolerance:
            break
        new_value = cost(candidate)
        expected = -float(step @ gradient) - 0.5 * float(step @ hessian @ step)
        gain = (value - new_value) / expected if expected > 0 else -1.0
        if np.isfinite(new_value) and new_value < value:
            x = candidate
            damping.mu = max(damping.mu * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-9)
            damping.nu = 2.0
            hessian, gradient, value = linearise(x)
        else:
            damping.mu = min(damping.mu * damping.nu, 1e12)
            damping.nu *= 2.0
    return x
