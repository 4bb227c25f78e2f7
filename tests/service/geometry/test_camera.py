"""The camera's conventions."""

import numpy as np
import pytest

from service.geometry.camera import Camera
from service.geometry.rotation import exp_rotation

FLIP = np.diag([1.0, -1.0, -1.0])


def camera(yaw: float, pitch: float, roll: float) -> Camera:
    turn = exp_rotation(np.radians([-pitch, 0.0, 0.0])) @ exp_rotation(np.radians([0.0, yaw, 0.0]))
    rotation = exp_rotation(np.radians([0.0, 0.0, roll])) @ FLIP @ turn
    return Camera(200, 100, 300.0, np.array([100.0, 50.0]), rotation, np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("angles", [(0, 0, 0), (40, 0, 0), (-60, 20, 0), (25, -15, 80), (0, 10, -120)])
def test_angles_come_back(angles: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(camera(*angles).yaw_pitch_roll_deg(), angles, atol=1e-9)


def test_signs() -> None:
    """The nose of a head that turns to the image right, looks up or leans clockwise moves there."""
    nose, crown = np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.1, 0.0]])
    assert camera(20, 0, 0).project(nose)[0, 0] > 100
    assert camera(0, 20, 0).project(nose)[0, 1] < 50
    assert camera(0, 0, 20).project(crown)[0, 0] > 100


def test_a_point_at_the_camera_stays_finite() -> None:
    c = camera(0, 0, 0)
    assert np.isfinite(c.project(c.centre[None])).all()
