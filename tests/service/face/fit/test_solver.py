"""Derivatives of the energy against finite differences; damped least squares on problems whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from service.face.fit.solver import (
    POSE,
    Damping,
    NormalPrior,
    PointTerm,
    Prior,
    State,
    System,
    Term,
    energy,
    linear,
    minimise,
    solve_step,
    weak_pose,
)
from service.geometry.camera import exp_rotation

COUNT, SHAPES = 12, 5
RANDOM = np.random.default_rng(7)
MEAN = RANDOM.normal(size=(COUNT, 3)) * 0.05
MOVES = (RANDOM.normal(size=(COUNT, 3, SHAPES)) * 0.01).astype(np.float32)
TARGET, WEIGHT = RANDOM.normal(size=(COUNT, 2)) * 100, RANDOM.uniform(0, 1e-2, COUNT)
ANGLE = RANDOM.uniform(0, 6, COUNT)
NORMAL = np.stack([np.cos(ANGLE), np.sin(ANGLE)], 1)
TERMS: dict[str, Term] = {
    "points": PointTerm(MEAN, MOVES, TARGET, WEIGHT),
    "contour": PointTerm(MEAN, MOVES, TARGET, WEIGHT, NORMAL),
    "one more prior": NormalPrior(np.array([0.7, -1.3])),
    "prior": Prior(0.1, 0.4, 7.0, 0.3, np.linspace(0.5, 3, SHAPES), np.linspace(-1, 1, SHAPES)),
}


@pytest.fixture()
def state() -> State:
    rotation = exp_rotation(np.array([0.2, -0.4, 0.1])) @ np.diag([1.0, -1.0, -1.0])
    return State(rotation, np.array([0.02, -0.01]), 7.2, 0.2, np.linspace(-1, 1, SHAPES))


@pytest.mark.parametrize("name", TERMS)
def test_gradient_agrees_with_finite_differences(name: str, state: State) -> None:
    terms = [TERMS[name]]
    system = System.of(terms, state)
    hessian, gradient = system.hessian, system.gradient
    # Shapes are float32.
    steps = np.diag([1e-6] * POSE + [1e-2] * SHAPES)
    numeric = [
        (energy([terms], [state.stepped(e)]) - energy([terms], [state.stepped(-e)])) / (2 * e.max()) for e in steps
    ]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-5 * np.abs(gradient).max())
    assert np.allclose(hessian, hessian.T)
    assert np.linalg.eigvalsh(hessian).min() > -1e-6 * np.abs(hessian).max()


def test_a_point_behind_the_camera_stays_finite() -> None:
    """Depth is clamped before the division; unclamped it would pass through zero."""
    state = State(np.eye(3), np.zeros(2), 7.0, np.log(0.2), np.zeros(SHAPES))
    term = PointTerm(MEAN - np.array([0, 0, 0.2]), MOVES, TARGET, WEIGHT)
    system = System.of([term], state)
    assert np.isfinite(system.hessian).all() and np.isfinite(system.gradient).all()
    assert np.isfinite(energy([[term]], [state]))


RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(40, 3)) * 0.05
MODES = (RNG.normal(size=(40, 3, 4)) * 0.005).astype(np.float32)
TRUTH = State(
    exp_rotation(np.array([0.1, 0.5, -0.1])) @ np.diag([1.0, -1, -1]),
    np.array([0.01, 0.02]),
    np.log(1500.0),
    np.log(0.9),
    np.array([1.0, -0.5, 0.3, 0.7]),
)
EVERYTHING = np.full(POSE + 4, np.inf)
SHARED = slice(POSE, POSE + 2)
"""The first two coefficients: the identity of several photos."""


def observed(state: State) -> np.ndarray:
    points = linear(POINTS, MODES, state.coefficients)
    middle_camera = state.camera(0, 0)
    return middle_camera.project(points)


def solve(start: State, steps: int = 60, lower: np.ndarray = -EVERYTHING, upper: np.ndarray = EVERYTHING) -> State:
    term = PointTerm(POINTS, MODES, observed(TRUTH), np.full(40, 1.0))
    active = np.ones(POSE + 4, bool)
    (found,) = minimise(
        [start], [[term]], shared=SHARED, lower=lower, upper=upper, damping=Damping(), steps=steps, active=active
    )
    return found


def test_exact_data_give_back_the_truth() -> None:
    start = State(np.diag([1.0, -1, -1]), np.zeros(2), np.log(1200.0), np.log(1.3), np.zeros(4))
    found = solve(start)
    np.testing.assert_allclose(found.coefficients, TRUTH.coefficients, atol=1e-4)
    np.testing.assert_allclose(found.rotation, TRUTH.rotation, atol=1e-5)
    assert found.log_distance == pytest.approx(TRUTH.log_distance, abs=1e-4)


def test_bounds_hold() -> None:
    """Without the projection an expression unit would leave [0, 1] and turn the face inside out."""
    lower, upper = -EVERYTHING.copy(), EVERYTHING.copy()
    lower[POSE:], upper[POSE:] = 0.0, 0.6
    found = solve(State(TRUTH.rotation, np.zeros(2), np.log(1500.0), 0.0, np.zeros(4)), lower=lower, upper=upper)
    assert found.coefficients.min() >= 0.0 and found.coefficients.max() <= 0.6


@pytest.mark.parametrize("kind", ["zero", "rank one", "indefinite", "not finite", "huge"])
def test_step_is_finite_for_hopeless_systems(kind: str) -> None:
    """A Cholesky factor of these does not exist or overflows; the step has to stay finite all the same."""
    h = {
        "zero": np.zeros((3, 3)),
        "rank one": np.ones((3, 3)),
        "indefinite": np.diag([1.0, -2.0, 0.0]),
        "not finite": np.full((3, 3), np.nan),
        "huge": np.full((3, 3), 1e308),
    }[kind]
    system = System(h, np.array([1.0, -1.0, 0.0]))
    for count in (1, 3):
        for step in solve_step([system] * count, slice(1, 2), 1e-3, [np.ones(3, bool)] * count):
            assert np.isfinite(step).all()


def test_a_step_of_several_photos_is_that_of_one_large_system() -> None:
    """The Schur complement, against a solve of all unknowns at once."""
    count, n, shared = 3, 9, slice(3, 6)
    own = np.r_[0:3, 6:9]
    systems = []
    for seed in range(count):
        j = np.random.default_rng(seed).normal(size=(20, n))
        systems.append(System(j.T @ j, np.random.default_rng(50 + seed).normal(size=n)))
    places = [np.r_[3 + 6 * k : 6 + 6 * k, 0:3, 6 + 6 * k : 9 + 6 * k] for k in range(count)]  # shared first
    whole, right = np.zeros((3 + 6 * count,) * 2), np.zeros(3 + 6 * count)
    for system, place in zip(systems, places, strict=True):
        whole[np.ix_(place, place)] += system.hessian
        right[place] += system.gradient
    expected = -np.linalg.solve(whole + 0.1 * np.diag(np.diag(whole)), right)
    free = [np.ones(n, bool)] * count
    for step, place in zip(solve_step(systems, shared, 0.1, free), places, strict=True):
        np.testing.assert_allclose(step, expected[place], rtol=1e-9)
    free[1] = np.isin(np.arange(n), own[1:]) | np.isin(np.arange(n), np.arange(3, 6))
    assert solve_step(systems, shared, 0.1, free)[1][own[0]] == 0.0, "what may not move stays"


def test_photos_of_one_head_agree_on_what_they_share() -> None:
    """The same head turned two ways, each photo blind to one of its coefficients."""
    other = State(exp_rotation(np.array([0.0, -0.6, 0.0])) @ np.diag([1.0, -1, -1]), np.zeros(2), 7.2, 0.1,
                  np.r_[TRUTH.coefficients[:2], 0.1, 0.9])  # fmt: skip
    halves = np.repeat([[1.0, 0.0], [0.0, 1.0]], 20, 1)
    pairs = zip((TRUTH, other), halves, strict=True)
    terms = [[PointTerm(POINTS, MODES, observed(state), half)] for state, half in pairs]
    start = [State(state.rotation, np.zeros(2), 7.0, 0.0, np.zeros(4)) for state in (TRUTH, other)]
    one, two = minimise(
        start, terms, shared=SHARED, lower=-EVERYTHING, upper=EVERYTHING, damping=Damping(), steps=80,
        active=np.ones(POSE + 4, bool),
    )  # fmt: skip
    np.testing.assert_array_equal(one.coefficients[:2], two.coefficients[:2])
    np.testing.assert_allclose(one.coefficients[:2], TRUTH.coefficients[:2], atol=1e-3)
    np.testing.assert_allclose(two.coefficients[2:], [0.1, 0.9], atol=1e-3)


def test_focal_length_cannot_run_away() -> None:
    """Distance and focal length are nearly degenerate: on noise alone an unbounded solve drifts to infinity."""
    prior = Prior(0.0, 10.0, 7.0, 10.0, np.ones(4), np.zeros(4))
    term = PointTerm(POINTS, MODES, RNG.normal(size=(40, 2)) * 300, np.full(40, 1.0))
    lower, upper = -EVERYTHING.copy(), EVERYTHING.copy()
    lower[6], upper[6] = np.log(0.15), np.log(20.0)
    start = State(TRUTH.rotation, np.zeros(2), 7.0, 0.0, np.zeros(4))
    (found,) = minimise(
        [start], [[term, prior]], shared=SHARED, lower=lower, upper=upper, damping=Damping(), steps=200,
        active=np.ones(POSE + 4, bool),
    )  # fmt: skip
    assert np.log(0.15) <= found.log_distance <= np.log(20.0)
    assert np.isfinite(found.unknowns()).all()


def test_weak_pose_recovers_an_orthographic_view() -> None:
    rotation = exp_rotation(np.array([0.2, -0.7, 0.3])) @ np.diag([1.0, -1, -1])
    pixels = 900.0 * (POINTS @ rotation.T)[:, :2] + np.array([12.0, -5.0])
    pose = weak_pose(POINTS, pixels, np.ones(40))
    np.testing.assert_allclose(pose.rotation, rotation, atol=1e-9)
    assert pose.scale == pytest.approx(900.0)
    np.testing.assert_allclose(pose.offset, [12.0, -5.0], atol=1e-6)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), [0.01, 0.02, 0.0])])
def test_weak_pose_of_a_point_or_a_line_is_frontal(points: np.ndarray) -> None:
    """These do not determine a pose: the normal equations are singular."""
    pose = weak_pose(points, np.zeros((5, 2)), np.ones(5))
    np.testing.assert_allclose(pose.rotation, np.diag([1.0, -1, -1]))
    assert np.isfinite(pose.scale) and pose.scale > 0
