"""A large photo is made smaller as far as its blur allows, and is read at the same places."""

from __future__ import annotations

import numpy as np
import pytest

from service.face.fit.softened import Softened


@pytest.mark.parametrize("sigma", [0.1, 2.0, 9.0, 40.0, 1e6])
def test_a_slope_is_read_where_it_was(sigma: float) -> None:
    across = np.arange(611)
    pixels = np.repeat(np.broadcast_to(across * 255 / 610, (401, 611)).astype(np.uint8)[..., None], 3, 2)
    soft = Softened.of(pixels, sigma)
    assert soft.image.shape[1] <= 611 / max(int(min(sigma, 50) / 4), 1)
    x, y = np.floor(soft.at(np.array([305.5, 200.5]))).astype(int)
    assert soft.image[y, x, 0] == pytest.approx(0.5, abs=0.02)


def test_a_small_blur_keeps_every_pixel() -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (40, 50, 3)).astype(np.uint8)
    soft = Softened.of(pixels, 0.2)
    assert (soft.image == pixels.astype(np.float32) / np.float32(255)).all()
    assert (soft.step == 1).all()
