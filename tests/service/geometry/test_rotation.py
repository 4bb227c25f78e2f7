"""Rotations: the exponential map against scipy, and its degenerate ends."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from service.geometry.rotation import exp_rotation, nearest_rotation, skew


@pytest.mark.parametrize("angle", [0.0, 1e-12, 5e-5, 1e-4, 1e-3, 1.0, np.pi - 1e-9, np.pi, 7.0])
def test_exponential_agrees_with_an_independent_implementation(angle: float) -> None:
    """Rodrigues divides by the angle: without the series 1e-12 would lose all digits and 0 would be NaN."""
    w = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    np.testing.assert_allclose(exp_rotation(w), Rotation.from_rotvec(w).as_matrix(), atol=1e-12)


def test_skew_is_the_cross_product() -> None:
    a, b = np.array([[1.0, 2, 3], [0, -1, 4]]), np.array([0.5, -2, 1])
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b))


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1.0, 1, -1]), np.ones((3, 3)), -np.eye(3)])
def test_nearest_rotation_is_a_rotation_even_of_singular_matrices(matrix: np.ndarray) -> None:
    r = nearest_rotation(matrix)
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1.0)
