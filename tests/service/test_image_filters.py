"""Filters against their definitions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.image_filters import blurred, by_strips

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
