"""Laying discs flat."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from models.head.chart.flatten import Patch, boundary_loop, energy, minimise, rest_frames, tutte

Float = npt.NDArray[np.float64]


def grid(n: int) -> tuple[Float, npt.NDArray[np.int64]]:
    x, y = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float))
    points = np.stack([x.ravel(), y.ravel(), 0.15 * (x.ravel() - n / 2) ** 2], 1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return points, np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)])


def patch_of(points: Float, triangles: npt.NDArray[np.int64], walls: Float | None = None) -> Patch:
    rest = rest_frames(points[triangles], np.ones(len(triangles)))
    weight = 0.5 * np.linalg.det(rest)
    none = np.zeros((0, 3)) if walls is None else walls
    return Patch(triangles, rest, weight, boundary_loop(triangles), np.zeros(0, np.int64), none, 0.5)


def circle(count: int) -> Float:
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], 1)


def areas(x: Float, triangles: npt.NDArray[np.int64]) -> Float:
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return np.asarray((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))


def test_a_developable_sheet_comes_out_undistorted() -> None:
    """A bent sheet can be laid flat exactly: energy 4 per unit of area (|J|^2 + |J^-1|^2 = 4 for a rotation)."""
    points, triangles = grid(9)
    patch = patch_of(points, triangles)
    start = 5 * tutte(patch, circle(len(patch.boundary)))
    x = minimise(patch, start, iterations=600, tolerance=1e-12)
    assert energy(patch, x)[0] == pytest.approx(4 * patch.weight.sum(), rel=1e-3)
    assert (areas(x, triangles) > 0).all()


def test_gradient_matches_differences() -> None:
    points, triangles = grid(5)
    patch = patch_of(points, triangles, np.array([[1.0, 0.0, 30.0], [0.6, 0.8, 25.0]]))
    x = 4 * tutte(patch, circle(len(patch.boundary)))
    gradient = energy(patch, x)[1]
    random = np.random.default_rng(0)
    for _ in range(5):
        d = random.normal(size=x.shape)
        slope = (energy(patch, x + 1e-6 * d)[0] - energy(patch, x - 1e-6 * d)[0]) / 2e-6
        assert slope == pytest.approx((gradient * d).sum(), rel=1e-5)
