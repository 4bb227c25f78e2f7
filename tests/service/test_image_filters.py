"""Filters against their definitions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.image_filters import ACROSS, STRIP, blurred, by_strips, each_around

NOISE = np.random.default_rng(5).normal(size=(301, 413, 3)).astype(np.float32)


@pytest.mark.parametrize("sigma", [8.0, 13.0, 20.0, 47.0])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_wide_blur_is_the_gaussian(sigma: float, channels: int) -> None:
    """Of noise over a ramp, at the border too, where the image goes on as its mirror image."""
    ramp = np.linspace(-1, 1, 413, dtype=np.float32)[None, :, None]
    image = NOISE[..., 0] + ramp[..., 0] if channels == 1 else NOISE + ramp
    exact = cv2.GaussianBlur(image, (0, 0), sigma)
    found = blurred(image, sigma)
    assert found.shape == image.shape and found.dtype == np.float32
    assert np.abs(found - exact).max() < 0.01 * float(image.std())


def test_strips_cover_the_map_in_order() -> None:
    found = by_strips(150, lambda rows: (rows.start, rows.stop), rows=64)
    assert found == [(0, 64), (64, 128), (128, 150)]
    with pytest.raises(ZeroDivisionError):
        by_strips(10, lambda rows: 1 // rows.start)


def test_what_marks_reach_is_changed_once_and_what_is_far_is_left() -> None:
    shape = (4 * STRIP, 4 * ACROSS)
    marks = np.zeros((32, 256), bool)
    marks[9, 60:66] = marks[12, 250] = marks[20, 0] = True
    times = np.zeros(shape, np.uint8)

    def change(rows: slice, columns: slice) -> None:
        assert columns.stop - columns.start <= ACROSS
        times[rows, columns] += 1

    each_around(marks, shape, change)
    reached = cv2.resize(marks.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR) > 0
    assert (times[reached] == 1).all()
    assert times.max() == 1
    assert not times[:STRIP].any(), "no marks in these rows"
    assert not times[STRIP : 2 * STRIP, 2 * ACROSS : 2 * ACROSS + ACROSS // 2].any(), "none between those of a strip"
