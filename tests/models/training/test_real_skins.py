"""Measures of relief on real skin, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")  # the light stage's measures come with it

from models.training.real_skins import by_axis, compare

PPM, LIMITS = 8.0, (8.0, 0.5, 4.0)


def relief(seed: int = 0, side: int = 128) -> np.ndarray:
    """Slopes along x and up of a smooth random height."""
    import cv2

    height = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(side, side)), (0, 0), 3.0)
    rows, columns = np.gradient(height)
    return np.stack([columns, -rows])


def test_axes_are_compared_apart() -> None:
    """Right along x and wrong along y is nothing on the whole; only apart it shows."""
    truth = relief()
    found = truth * np.array([1.0, -1.0])[:, None, None]
    assert by_axis(found, truth, *LIMITS) == "1.00 / -1.00"
    assert abs(compare(found, truth, *LIMITS)[0]) < 0.2
    assert compare(2.0 * truth, truth, *LIMITS) == pytest.approx((1.0, 2.0))
    assert compare(np.zeros_like(truth), truth, *LIMITS) == (0.0, 0.0)
    assert by_axis(truth, np.zeros_like(truth), *LIMITS) == "0.00 / 0.00"
