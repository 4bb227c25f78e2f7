"""The photo blurred for the fit."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.face.fit.outline import Softened


@pytest.mark.parametrize("sigma", [0.1, 2.0, 9.0, 40.0, 1e6])
def test_a_slope_is_read_where_it_was(sigma: float) -> None:
    across = np.arange(611)
    pixels = np.repeat(np.broadcast_to(across * 255 / 610, (401, 611)).astype(np.uint8)[..., None], 3, 2)
    soft = Softened.of(pixels, sigma, np.array([[0.0, 0.0], [611.0, 401.0]]))
    assert soft.image.shape[1] <= 611 / max(int(min(sigma, 50) / 4), 1)
    x, y = np.floor(soft.at(np.array([305.5, 200.5]))).astype(int)
    assert soft.image[y, x, 0] == pytest.approx(0.5, abs=0.02)


def test_around_a_small_head_the_same_is_read_and_no_more_is_kept() -> None:
    coarse = np.random.default_rng(0).integers(0, 255, (50, 70, 3)).astype(np.uint8)
    pixels = np.asarray(cv2.resize(coarse, (1400, 1000)), np.uint8)
    head = np.array([[601.0, 401.0], [799.0, 603.0]])
    for sigma in (2.0, 9.0):
        soft = Softened.of(pixels, sigma, head)
        whole = Softened.of(pixels, sigma, np.array([[0.0, 0.0], [1400.0, 1000.0]]))
        assert soft.image.size < 0.3 * whole.image.size
        read = []
        for one in (soft, whole):
            x, y = np.moveaxis(one.at(np.random.default_rng(1).uniform(head[0], head[1], (1, 500, 2))) - 0.5, 2, 0)
            read.append(cv2.remap(one.image, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR))
        np.testing.assert_allclose(read[0], read[1], atol=0.01)


def test_a_head_beside_the_photo_leaves_one_pixel() -> None:
    pixels = np.full((40, 50, 3), 90, np.uint8)
    for head in ([[500.0, 300.0], [600.0, 400.0]], [[-600.0, -400.0], [-500.0, -300.0]]):
        assert Softened.of(pixels, 6.0, np.array(head)).image.shape == (1, 1, 3)
