"""Sampling against closed forms: what a pixel is, what an area is, what happens at the border."""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.sampling import Pyramid, sample_area


def _ramp(width: int, height: int) -> np.ndarray:
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x, y], -1)


def test_a_linear_image_is_read_exactly_between_pixels() -> None:
    points = np.random.default_rng(0).uniform(1, 30, (200, 2))
    assert np.allclose(Pyramid.build(_ramp(40, 33)).sample(points), points, atol=0.04)


def test_border_repeats_and_wild_points_are_safe() -> None:
    pyramid = Pyramid.build(np.full((8, 8, 3), 0.25))
    points = np.array([[-1e9, 4], [1e9, 1e9], [np.nan, 2], [np.inf, -np.inf]])
    assert np.allclose(pyramid.sample(points, np.array([1, 1e9, np.nan, 2])), 0.25)


def test_more_points_than_the_library_takes_in_one_row() -> None:
    points = np.tile([[3.5, 2.5]], (70_000, 1))
    assert np.allclose(Pyramid.build(_ramp(8, 8)).sample(points), [3.5, 2.5])


@pytest.mark.parametrize("size", [2.0, 4.0, 8.0])
def test_fine_checks_average_to_grey(size: float) -> None:
    """Point sampling a one-pixel checkerboard would give black and white noise instead."""
    y, x = np.mgrid[:64, :64]
    pyramid = Pyramid.build(((x + y) % 2).astype(float))
    points = np.random.default_rng(1).uniform(16, 48, (100, 2))
    jacobian = np.tile(np.eye(2) * size, (100, 1, 1))
    assert np.abs(sample_area(pyramid, points, jacobian) - 0.5).max() < 0.1


def test_a_long_footprint_does_not_blur_across() -> None:
    """Stripes along x, seen by a footprint of 4 x 1 pixels along x: full contrast must remain."""
    y, _ = np.mgrid[:64, :64]
    pyramid = Pyramid.build(((y // 2) % 2).astype(float))
    points = np.array([[32.0, 32.0 + i + 1.0] for i in (0, 2, 4, 6)])
    jacobian = np.tile(np.array([[4.0, 0.0], [0.0, 1.0]]), (4, 1, 1))
    value = sample_area(pyramid, points, jacobian)[:, 0]
    assert np.allclose(value, [0, 1, 0, 1], atol=0.3)
