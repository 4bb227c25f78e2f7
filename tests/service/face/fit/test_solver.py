"""Damped least squares on problems whose answers are known, and on systems that degenerate."""

import numpy as np
import pytest

from service.face.fit.pose_state import POSE, State, weak_pose
from service.face.fit.solver import Damping, PointTerm, Prior, minimise, solve_step
from service.geometry.camera import exp_rotation

RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(40, 3)) * 0.05
MODES = RNG.normal(size=(4, 40, 3)) * 0.005
TRUTH = State(
    exp_rotation(np.array([0.1, 0.5, -0.1])) @ np.diag([1.0, -1, -1]),
    np.array([0.01, 0.02]),
    np.log(1500.0),
    np.log(0.9),
    np.array([1.0, -0.5, 0.3, 0.7]),
)
EVERYTHING = np.full(POSE + 4, np.inf)


def observed(state: State) -> np.ndarray:
    points = POINTS + np.tensordot(state.coefficients, MODES, 1)
    middle_camera = state.camera(0, 0)
    return middle_camera.project(points)


def solve(start: State, steps: int = 60, lower: np.ndarray = -EVERYTHING, upper: np.ndarray = EVERYTHING) -> State:
    term = PointTerm(POINTS, MODES, observed(TRUTH), np.full(40, 1.0))
    active = np.ones(POSE + 4, bool)
    return minimise(start, [term], lower=lower, upper=upper, damping=Damping(), steps=steps, active=active)


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
    step = solve_step(h, np.array([1.0, -1.0, 0.0]), 1e-3, np.ones(3, bool))
    assert np.isfinite(step).all()


def test_focal_length_cannot_run_away() -> None:
    """Distance and focal length are nearly degenerate: on noise alone an unbounded solve drifts to infinity."""
    prior = Prior(0.0, 10.0, 7.0, 10.0, np.ones(4), np.zeros(4))
    term = PointTerm(POINTS, MODES, RNG.normal(size=(40, 2)) * 300, np.full(40, 1.0))
    lower, upper = -EVERYTHING.copy(), EVERYTHING.copy()
    lower[6], upper[6] = np.log(0.15), np.log(20.0)
    start = State(TRUTH.rotation, np.zeros(2), 7.0, 0.0, np.zeros(4))
    found = minimise(
        start, [term, prior], lower=lower, upper=upper, damping=Damping(), steps=200, active=np.ones(POSE + 4, bool)
    )
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
