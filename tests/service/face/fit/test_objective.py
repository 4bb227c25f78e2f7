"""The energy's derivatives against finite differences: a wrong sign or a missing factor in a Jacobian breaks these."""

import numpy as np
import pytest

from service.face.fit.solver import PointTerm, Prior, State, System, Term, energy
from service.geometry.camera import exp_rotation

COUNT, SHAPES = 12, 5
RNG = np.random.default_rng(7)
MEAN, MODES = RNG.normal(size=(COUNT, 3)) * 0.05, RNG.normal(size=(SHAPES, COUNT, 3)) * 0.01
TARGET, WEIGHT = RNG.normal(size=(COUNT, 2)) * 100, RNG.uniform(0, 1e-2, COUNT)
ANGLE = RNG.uniform(0, 6, COUNT)
NORMAL = np.stack([np.cos(ANGLE), np.sin(ANGLE)], 1)
TERMS: dict[str, Term] = {
    "points": PointTerm(MEAN, MODES, TARGET, WEIGHT),
    "contour": PointTerm(MEAN, MODES, TARGET, WEIGHT, NORMAL),
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
    steps = np.eye(len(gradient)) * 1e-6
    numeric = [(energy([terms], [state.stepped(e)]) - energy([terms], [state.stepped(-e)])) / 2e-6 for e in steps]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-5 * np.abs(gradient).max())
    assert np.allclose(hessian, hessian.T)
    assert np.linalg.eigvalsh(hessian).min() > -1e-6 * np.abs(hessian).max()


def test_a_point_behind_the_camera_stays_finite() -> None:
    """Depth is clamped before the division; unclamped it would pass through zero."""
    state = State(np.eye(3), np.zeros(2), 7.0, np.log(0.2), np.zeros(SHAPES))
    term = PointTerm(MEAN - np.array([0, 0, 0.2]), MODES, TARGET, WEIGHT)
    system = System.of([term], state)
    assert np.isfinite(system.hessian).all() and np.isfinite(system.gradient).all()
    assert np.isfinite(energy([[term]], [state]))
