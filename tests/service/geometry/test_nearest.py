"""Nearest points against scipy's k-d tree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from service.geometry.nearest import Nearest


@pytest.mark.parametrize(("size", "axes", "count"), [(5000, 3, 4), (300, 4, 24), (2000, 2, 1), (7, 3, 7)])
def test_is_exact(size: int, axes: int, count: int) -> None:
    rng = np.random.default_rng(size)
    points = rng.normal(0, 0.1, (size, axes)).astype(np.float32)
    places = rng.normal(0, 0.15, (900, axes)).astype(np.float32)
    apart, index = Nearest(points)(places, count)
    expected = cKDTree(points).query(places, k=range(1, count + 1))[0]
    assert apart.shape == index.shape == (900, count)
    np.testing.assert_allclose(apart, expected, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(points[index] - places[:, None], axis=2), apart, rtol=1e-5, atol=1e-7)


def test_fewer_points_than_asked_for() -> None:
    apart, index = Nearest(np.zeros((2, 3)))(np.ones((4, 3)), 5)
    assert apart.shape == index.shape == (4, 2)
    assert Nearest(np.zeros((2, 3)))(np.zeros((0, 3)), 5)[0].shape == (0, 2)


def test_the_points_may_be_dropped_and_changed() -> None:
    """OpenCV's tree points into the array that it was given: freed or written to, answers were nonsense."""
    points = np.random.default_rng(0).random((400, 3)).astype(np.float32)
    tree, places = Nearest(points), points.copy()
    points[:] = 7.0
    apart, index = tree.one(places)
    assert not apart.any() and (index == np.arange(400)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(bad: float) -> None:
    points = np.zeros((4, 3))
    with pytest.raises(ValueError, match="finite"):
        Nearest(np.where(np.arange(12).reshape(4, 3) == 5, bad, points))
    with pytest.raises(ValueError, match="finite"):
        Nearest(points)(np.full((1, 3), bad))
    with pytest.raises(ValueError, match="at least 1"):
        Nearest(np.zeros((0, 3)))
