"""The fit's unknowns, its energy, and damped least squares (Levenberg-Marquardt) with box bounds that minimises it.

The unknowns are

    w (3) rotation step, tx, ty (2) metres, log scale, log distance, identity (K), expression (E)

with scale = focal / distance in pixels per metre. Focal length and distance are nearly degenerate for a face, whereas
scale and distance are nearly independent. Every photo has terms and a state of its own; the head's identity is the same
in all states. A term returns half its sum of squares and adds J^T J and J^T r in place.

Nielsen's damping rule: a good step shrinks the damping smoothly, a bad one grows it ever faster (K. Madsen, H. B.
Nielsen, O. Tingleff, Methods for Non-Linear Least Squares Problems, 2004, section 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from service.arrays import Bool, Float32, Float64
from service.geometry.camera import NEAREST_M, Camera, exp_rotation, nearest_rotation, skew

POSE = 7
"""Number of pose unknowns, which precede the shape coefficients."""


@dataclass(frozen=True)
class State:
    """A pose with shape coefficients.

    Attributes:
        rotation: (3, 3) head to camera.
        translation_xy: (2,) metres.
        log_scale: log of focal / distance in pixels per metre.
        log_distance: log of the distance of the head's origin in metres.
        coefficients: (K + E,) identity, then expression.
    """

    rotation: Float64
    translation_xy: Float64
    log_scale: float
    log_distance: float
    coefficients: Float64

    def stepped(self, step: Float64) -> State:
        """The state after a step of the unknowns: a rotation multiplied from the left, and a sum for the rest."""
        x = self.unknowns() + step
        rotation = nearest_rotation(exp_rotation(step[:3]) @ self.rotation)
        return State(rotation, x[3:5], float(x[5]), float(x[6]), x[POSE:])

    def unknowns(self) -> Float64:
        """(7 + K + E,) unknowns; the rotation is zero, since steps are relative to it."""
        pose = [np.zeros(3), self.translation_xy, [self.log_scale, self.log_distance]]
        return np.concatenate([*pose, self.coefficients])

    @property
    def scale(self) -> float:
        """Pixels per metre at the head's origin."""
        return float(np.exp(self.log_scale))

    @property
    def translation(self) -> Float64:
        """(3,) metres."""
        return np.array([*self.translation_xy, np.exp(self.log_distance)])

    @property
    def yaw_deg(self) -> float:
        """As :meth:`Camera.yaw_pitch_roll_deg` has it."""
        return _yaw_deg(self.rotation)

    def camera(self, width: int, height: int) -> Camera:
        """The pinhole camera of this pose, principal point in the middle of the photo."""
        focal = float(np.exp(self.log_scale + self.log_distance))
        middle = np.array([width / 2, height / 2], np.float64)
        return Camera(width, height, focal, middle, self.rotation, self.translation)


@dataclass(frozen=True)
class Projection:
    """Points seen by a state.

    Attributes:
        turned: (N, 3) metres, rotated into camera axes, not translated.
        position: (N, 3) metres, camera space, depth clamped to NEAREST_M.
        uv: (N, 2) pixels relative to the principal point.
    """

    turned: Float64
    position: Float64
    uv: Float64


def project_points(state: State, points: Float64) -> Projection:
    """Project (N, 3) head-space metres."""
    turned = points @ state.rotation.T
    position = turned + state.translation
    position[:, 2] = np.maximum(position[:, 2], NEAREST_M)
    focal = np.exp(state.log_scale + state.log_distance)
    return Projection(turned, position, focal * position[:, :2] / position[:, 2:])


@dataclass(frozen=True)
class WeakPose:
    """Scaled orthographic pose: pixel = scale * (rotation @ X)[:2] + offset.

    Attributes:
        rotation: (3, 3), camera axes x right, y down, z forward.
        scale: pixels per metre, > 0.
        offset: (2,) pixels.
    """

    rotation: Float64
    scale: float
    offset: Float64

    @property
    def yaw_deg(self) -> float:
        """As :meth:`Camera.yaw_pitch_roll_deg` has it."""
        return _yaw_deg(self.rotation)


def _yaw_deg(rotation: Float64) -> float:
    return float(np.degrees(np.arctan2(rotation[2, 0], -rotation[2, 2])))


def weak_pose(points: Float64, pixels: Float64, weights: Float64) -> WeakPose:
    """Least-squares scaled orthographic pose.

    Args:
        points: (N, 3) metres, head space.
        pixels: (N, 2).
        weights: (N,) >= 0, at least one positive.

    Returns:
        The pose; where the points do not determine it (fewer than four, or all on one line) an upright frontal one
        at the scale that the spread of the pixels suggests.
    """
    w = weights / max(float(weights.sum()), 1e-12)
    centre, middle = w @ points, w @ pixels
    x, u = points - centre, pixels - middle
    spread_x = float(np.sqrt((w[:, None] * x**2).sum()))
    spread_u = float(np.sqrt((w[:, None] * u**2).sum()))
    scale = max(spread_u, 1e-6) / max(spread_x, 1e-6)
    rotation = np.diag([1.0, -1.0, -1.0])
    moment = x.T @ (w[:, None] * x)
    if np.linalg.eigvalsh(moment)[0] > 1e-10:
        m = (np.linalg.solve(moment, x.T @ (w[:, None] * u))).T
        candidate_scale = float(np.linalg.norm(m, axis=1).mean())
        if candidate_scale > 1e-6:
            scale = candidate_scale
            unit = m / scale
            rotation = nearest_rotation(np.vstack([unit, np.cross(unit[0], unit[1])]))
    return WeakPose(rotation, scale, middle - scale * (rotation @ centre)[:2])


class Term(Protocol):
    """One addend of the energy."""

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""


class Residuals:
    """A term of N independent residuals, each a vector with one precision; subclasses say what they are."""

    modes: Float32
    """(N, 3, M) derivative of a head-space vector of each by the coefficients."""
    precision: Float64
    """(N,) >= 0, weights included."""

    def residual(self, state: State) -> Float64:
        """(N, k) at a state."""
        raise NotImplementedError

    def slopes(self, state: State) -> tuple[Float64, Float64, Float64]:
        """It, and its derivatives (N, k, 7) by the pose and (N, k, 3) by that vector."""
        raise NotImplementedError

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        return 0.5 * float((self.precision[:, None] * self.residual(state) ** 2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place; computed in float32, which errs far less than a linear step does."""
        root = np.sqrt(self.precision)[:, None]
        residual, by_pose, by_vector = self.slopes(state)
        j = np.zeros((*by_pose.shape[:2], len(gradient)), np.float32)
        j[..., :POSE] = by_pose * root[:, :, None]
        np.matmul((by_vector * root[:, :, None]).astype(np.float32), self.modes, out=j[..., POSE:])
        j = j.reshape(-1, len(gradient))
        hessian += j.T @ j
        gradient += j.T @ (residual * root).astype(np.float32).ravel()


@dataclass(frozen=True)
class PointTerm(Residuals):
    """Reprojection error of points, in pixels.

    Attributes:
        mean, modes: (N, 3) and (N, 3, M) metres, the points as a linear function of the coefficients.
        target: (N, 2) pixels relative to the principal point.
        precision: (N,) 1 / px^2.
        normal: (N, 2) unit vectors if only the distance along them counts (points on a contour), else None.
    """

    mean: Float64
    modes: Float32
    target: Float64
    precision: Float64
    normal: Float64 | None = None

    def _projected(self, state: State) -> tuple[Projection, Float64]:
        seen = project_points(state, linear(self.mean, self.modes, state.coefficients))
        r = seen.uv - self.target
        return seen, r if self.normal is None else np.asarray((r * self.normal).sum(1, keepdims=True))

    def residual(self, state: State) -> Float64:
        """(N, 2), or (N, 1) along the normals."""
        return self._projected(state)[1]

    def slopes(self, state: State) -> tuple[Float64, Float64, Float64]:
        """(N, 2 or 1), (N, 2 or 1, 7) and (N, 2 or 1, 3)."""
        seen, residual = self._projected(state)
        # By the position in camera space.
        by_place: Float64 = np.zeros((len(seen.uv), 2, 3))
        by_place[:, 0, 0] = by_place[:, 1, 1] = np.exp(state.log_scale + state.log_distance)
        by_place[:, :, 2] = -seen.uv
        by_place /= seen.position[:, 2, None, None]
        if self.normal is not None:
            by_place = self.normal[:, None] @ by_place
        by_pose = np.zeros((*by_place.shape[:2], POSE))
        by_pose[..., :3] = -by_place @ skew(seen.turned)
        by_pose[..., 3:5] = by_place[..., :2]
        # The focal length moves with both logarithms.
        zoom = seen.uv[:, :, None] if self.normal is None else self.normal[:, None] @ seen.uv[:, :, None]
        by_pose[..., 5:6] = zoom
        by_pose[..., 6:7] = zoom + by_place[..., 2:] * np.exp(state.log_distance)
        return residual, by_pose, by_place @ state.rotation


def linear(mean: Float64, modes: Float32, coefficients: Float64) -> Float64:
    """(N, 3) mean (N, 3) and modes (N, 3, M) at coefficients (M,)."""
    return np.asarray(mean + modes @ coefficients.astype(np.float32))


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


@dataclass(frozen=True)
class NormalPrior:
    """One more Gaussian prior: a product with the coefficients that has mean 0 and variance 1.

    Attributes:
        row: (M,) of the product, with the first M coefficients.
    """

    row: Float64

    def cost(self, state: State) -> float:
        """Half the square."""
        return 0.5 * float(self.row @ state.coefficients[: len(self.row)]) ** 2

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        own = slice(POSE, POSE + len(self.row))
        hessian[own, own] += np.outer(self.row, self.row)
        gradient[own] += self.row * float(self.row @ state.coefficients[: len(self.row)])


@dataclass
class Damping:
    """Damping kept between calls, so that a solve can be resumed after the weights changed."""

    mu: float = 1e-3
    nu: float = 2.0


@dataclass(frozen=True)
class System:
    """Normal equations of one photo: J^T J (n, n) and J^T r (n,) by a step as :meth:`State.stepped` takes it."""

    hessian: Float64
    gradient: Float64

    @classmethod
    def of(cls, terms: Sequence[Term], state: State) -> System:
        """The system of all terms at a state."""
        n = POSE + len(state.coefficients)
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        for term in terms:
            term.add(state, hessian, gradient)
        return cls(hessian, gradient)


def energy(terms: Sequence[Sequence[Term]], states: Sequence[State]) -> float:
    """The sum of each photo's terms at its state."""
    return sum(sum(term.cost(state) for term in own) for own, state in zip(terms, states, strict=True))


@np.errstate(over="ignore", invalid="ignore")  # the steps are checked
def solve_step(systems: Sequence[System], shared: slice, mu: float, free: Sequence[Bool]) -> list[Float64]:
    """The damped Gauss-Newton step over the free variables of all photos; zero for the others.

    Marquardt's scaling by the diagonal, floored so that a variable that no residual sees stays put instead of
    making the system singular. What only one photo knows is eliminated from its own equations, but for the first
    photo's, so that the work grows linearly with the photos (Schur complement; "bundle adjustment": Triggs et al.
    1999). One photo is solved as it stands.

    Args:
        systems: one for each photo.
        shared: the unknowns that are the same in all photos.
        mu: damping > 0.
        free: (n,) variables that may move, for each photo; the shared ones alike in all.

    Returns:
        (n,) step of each photo, finite: where the factorisation fails, the minimum-norm solution; zero if that is not
        finite.
    """
    first, others = systems[0], systems[1:]
    hessian, gradient = first.hessian, first.gradient
    if others:
        hessian, gradient = hessian.copy(), gradient.copy()
        for one in others:
            hessian[shared, shared] += one.hessian[shared, shared]
            gradient[shared] += one.gradient[shared]
    steps = [np.zeros_like(one.gradient) for one in systems]
    index = np.flatnonzero(free[0])
    if index.size == 0:
        return steps
    h, g = hessian[np.ix_(index, index)], gradient[index]
    damped = h + np.diag(mu * np.maximum(np.diag(h), 1e-6))
    mine = np.flatnonzero((index >= shared.start) & (index < shared.stop))
    common, own = index[mine], []
    for one, may in zip(others, free[1:], strict=True):
        apart = np.flatnonzero(may)
        apart = apart[(apart < shared.start) | (apart >= shared.stop)]
        block = one.hessian[np.ix_(apart, apart)]
        right = np.concatenate([one.hessian[np.ix_(apart, common)], one.gradient[apart, None]], 1)
        solved = _solved(block + np.diag(mu * np.maximum(np.diag(block), 1e-6)), right)
        if solved is None:
            return steps
        damped[np.ix_(mine, mine)] -= right[:, :-1].T @ solved[:, :-1]
        g[mine] -= right[:, :-1].T @ solved[:, -1]
        own.append((apart, solved))
    part = _solved(damped, g)
    if part is None:
        return steps
    steps[0][index] = -part
    for step, (apart, solved) in zip(steps[1:], own, strict=True):
        step[common] = -part[mine]
        step[apart] = solved[:, :-1] @ part[mine] - solved[:, -1]
    return steps


def _solved(matrix: Float64, right: Float64) -> Float64 | None:
    """Solution of a symmetric system, None where none is finite."""
    try:
        factor = np.linalg.cholesky(matrix)
        part = np.linalg.solve(factor.T, np.linalg.solve(factor, right))
    except np.linalg.LinAlgError:
        if not np.isfinite(matrix).all():
            return None
        part = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    return part if np.isfinite(part).all() else None


def minimise(
    states: Sequence[State],
    terms: Sequence[Sequence[Term]],
    *,
    shared: slice,
    lower: Float64,
    upper: Float64,
    damping: Damping,
    steps: int,
    active: Bool,
    tolerance: float = 1e-6,
) -> list[State]:
    """Take up to ``steps`` damped steps; the energy never rises.

    Args:
        states: start of each photo, finite, inside the bounds, alike in what is shared.
        terms: addends of the energy, for each photo.
        shared: the unknowns that are the same in all photos.
        lower: (n,) least value of each unknown, minus infinity where there is none.
        upper: (n,) greatest value, infinity where there is none.
        damping: updated in place.
        steps: how many steps to try at most.
        active: (n,) unknowns that may move.
        tolerance: stop when no unknown moves by more.

    Returns:
        The best states seen.
    """
    value = energy(terms, states)
    states, systems = list(states), list[System]()
    for _ in range(steps):
        systems = systems or [System.of(own, state) for own, state in zip(terms, states, strict=True)]
        now = [state.unknowns() for state in states]
        total = sum(one.gradient[shared] for one in systems)
        free = []
        for x, one in zip(now, systems, strict=True):
            gradient = one.gradient.copy()
            gradient[shared] = total
            free.append(active & ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))))
        moves = solve_step(systems, shared, damping.mu, free)
        moves = [np.clip(x + move, lower, upper) - x for x, move in zip(now, moves, strict=True)]
        if not max(np.abs(move).max(initial=0.0) for move in moves) > tolerance:
            break
        candidates = [state.stepped(move) for state, move in zip(states, moves, strict=True)]
        new_value = energy(terms, candidates)
        expected = sum(
            -float(move @ one.gradient) - 0.5 * float(move @ one.hessian @ move)
            for move, one in zip(moves, systems, strict=True)
        )
        if np.isfinite(new_value) and new_value < value:
            gain = min((value - new_value) / expected, 1.0) if expected > 0 else 0.0
            damping.mu = max(damping.mu * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-9)
            damping.nu = 2.0
            states, value, systems = candidates, new_value, []
        else:
            damping.mu = min(damping.mu * damping.nu, 1e12)
            damping.nu = min(2.0 * damping.nu, 1e6)
    return states
