"""The camera's conventions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from service.geometry.camera import Camera, exp_rotation, nearest_rotation

FLIP = np.diag([1.0, -1.0, -1.0])


def camera(yaw: float, pitch: float, roll: float) -> Camera:
    turn = exp_rotation(np.radians([-pitch, 0.0, 0.0])) @ exp_rotation(np.radians([0.0, yaw, 0.0]))
    rotation = exp_rotation(np.radians([0.0, 0.0, roll])) @ FLIP @ turn
    return Camera(200, 100, 300.0, np.array([100.0, 50.0]), rotation, np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("angles", [(0, 0, 0), (40, 0, 0), (-60, 20, 0), (25, -15, 80), (0, 10, -120)])
def test_angles_come_back(angles: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(camera(*angles).yaw_pitch_roll_deg(), angles, atol=1e-9)


def test_a_point_at_the_camera_stays_finite() -> None:
    c = camera(0, 0, 0)
    assert np.isfinite(c.project(c.centre[None])).all()


@pytest.mark.parametrize("angle", [0.0, 1e-12, 5e-5, 1e-4, 1e-3, 1.0, np.pi - 1e-9, np.pi, 7.0])
def test_exponential_agrees_with_an_independent_implementation(angle: float) -> None:
    """Rodrigues divides by the angle: without the series 1e-12 would lose all digits and 0 would be NaN."""
    w = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    np.testing.assert_allclose(exp_rotation(w), Rotation.from_rotvec(w).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1.0, 1, -1]), np.ones((3, 3)), -np.eye(3)])
def test_nearest_rotation_is_a_rotation_even_of_singular_matrices(matrix: np.ndarray) -> None:
    r = nearest_rotation(matrix)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1.0)
