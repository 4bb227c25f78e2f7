"""Sampling against closed forms: what a pixel is, what an area is, what happens at the border."""

from __future__ import annotations

import numpy as np

from service.geometry.sampling import Pyramid


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
