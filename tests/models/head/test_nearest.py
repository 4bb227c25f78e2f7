"""Nearest points on triangles."""

from __future__ import annotations

import numpy as np

from models.head.nearest import nearest_on_triangles


def test_against_dense_sampling() -> None:
    random = np.random.default_rng(0)
    corners, points = random.normal(size=(60, 3, 3)), 2 * random.normal(size=(60, 3))
    weights = nearest_on_triangles(corners, points)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(1), 1)
    found = np.linalg.norm(np.einsum("nk,nkc->nc", weights, corners) - points, axis=1)
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60)))
    grid = np.stack([1 - u - v, u, v], 1)[u + v <= 1]
    dense = np.linalg.norm(np.einsum("gk,nkc->ngc", grid, corners) - points[:, None], axis=2).min(1)
    assert (found <= dense + 1e-9).all()
    assert (dense - found < 0.05).all()


def test_triangles_without_area_count_as_their_edges() -> None:
    line = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    weights = nearest_on_triangles(line, np.array([[1.5, 1.0, 0.0]]))
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", weights, line), [[1.5, 0, 0]])
    dot = np.zeros((1, 3, 3))
    assert np.isfinite(nearest_on_triangles(dot, np.array([[1.0, 0, 0]]))).all()
