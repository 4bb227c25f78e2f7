"""Strain of surfaces whose stretches are known."""

from __future__ import annotations

import numpy as np

from service.reflectance.relief.folds import Strain


def forms(du: tuple[float, float, float], dv: tuple[float, float, float]) -> np.ndarray:
    """(1, 1, 3) first fundamental form of a plane with these derivatives."""
    u, v = np.array(du), np.array(dv)
    return np.array([[[u @ u, u @ v, v @ v]]], np.float32)


def test_a_known_stretch_is_found_on_a_slanted_chart() -> None:
    """Squeezed to 0.7 along (cos 30, sin 30) of the surface and stretched to 1.1 across it, on a chart with shear."""
    turn = np.radians(30)
    axis = np.array([np.cos(turn), np.sin(turn)])
    normal = np.array([-axis[1], axis[0]])
    motion = 0.7 * np.outer(axis, axis) + 1.1 * np.outer(normal, normal)
    chart = np.array([[2.0, 0.6], [0.0, 1.5]])  # columns are X_u and X_v in the plane
    moved = motion @ chart
    still = forms((*chart[:, 0], 0), (*chart[:, 1], 0))
    strain = Strain.of(still, forms((*moved[:, 0], 0), (*moved[:, 1], 0)))
    stretch, across = strain.smallest()
    assert abs(stretch[0, 0] - 0.7) < 1e-5
    assert abs(abs(across[0, 0] @ axis) - 1) < 1e-5
    assert abs(strain.along(across)[0, 0] - 0.7) < 1e-5


def test_turning_and_moving_is_no_strain() -> None:
    still = forms((2, 0, 0), (0.6, 1.5, 0))
    turned = forms((0, 0, 2), (0, 1.5, 0.6))
    stretch, _ = Strain.of(still, turned).smallest()
    np.testing.assert_allclose(stretch, 1, atol=1e-6)


def test_a_chart_without_area_is_still() -> None:
    strain = Strain.of(np.zeros((2, 2, 3), np.float32), np.ones((2, 2, 3), np.float32))
    stretch, across = strain.smallest()
    np.testing.assert_array_equal(stretch, 1)
    assert np.isfinite(across).all()
