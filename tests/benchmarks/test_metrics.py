"""The measure of the shape benchmark on surfaces whose distance is known."""

import numpy as np
import pytest

from benchmarks.metrics import aligned_distance, similarity
from service.geometry.camera import exp_rotation

RNG = np.random.default_rng(4)


def ellipsoid(n: int, axes: tuple[float, float, float] = (0.07, 0.1, 0.08)) -> np.ndarray:
    v = RNG.normal(size=(n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True) * np.array(axes))


def test_similarity_is_recovered() -> None:
    points = ellipsoid(50)
    rotation = exp_rotation(np.array([0.3, -0.2, 0.9]))
    scale, found, offset = similarity(points, 1.7 * points @ rotation + [1.0, 2.0, 3.0])
    assert scale == pytest.approx(1.7)
    np.testing.assert_allclose(found, rotation, atol=1e-9)
    np.testing.assert_allclose(offset, [1.0, 2.0, 3.0], atol=1e-9)


def test_a_moved_copy_has_no_error() -> None:
    surface = ellipsoid(60_000)
    truth = 0.4 * surface[:3000] @ exp_rotation(np.array([0.0, 1.0, 0.2])) + 5.0
    assert aligned_distance(surface, (surface[:3000], truth), truth).max() < 1e-6


def test_a_bump_that_no_alignment_can_hide_is_measured() -> None:
    """A millimetre of noise along the normal on a surface: the median of |N(0, 1 mm)| is 0.67 mm."""
    surface = ellipsoid(200_000)
    truth = surface[:4000] * (1 + RNG.normal(size=(4000, 1)) * 0.001 / np.linalg.norm(surface[:4000], axis=1)[:, None])
    error = np.median(aligned_distance(surface, (surface[:4000], truth), truth))
    assert 0.0005 < error < 0.0009


def test_points_that_coincide_do_not_divide_by_zero() -> None:
    scale, rotation, offset = similarity(np.zeros((5, 3)), np.ones((5, 3)))
    assert scale == 1.0 and np.array_equal(rotation, np.eye(3)) and np.allclose(offset, 1.0)
