"""The measures of the benchmark of lights: each on a case whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.heads import TexturedHead
from benchmarks.light_spread import psnr, true_albedo
from service.colour import linear_to_srgb, srgb_to_linear

pytestmark = pytest.mark.train

RNG = np.random.default_rng(0)


def test_a_gain_of_linear_values_is_forgiven_once_and_not_in_the_raw_number() -> None:
    truth = RNG.uniform(0.2, 0.7, (500, 3))
    darker = linear_to_srgb((0.6 * srgb_to_linear(truth.astype(np.float32))).astype(np.float32)).astype(np.float64)
    raw, best = psnr(darker, truth)
    assert raw < 25
    assert best > 60
    assert psnr(truth, truth) == (100.0, 100.0)


def test_nothing_to_compare_is_an_error() -> None:
    with pytest.raises(ValueError, match="no pixel"):
        psnr(np.zeros((0, 3)), np.zeros((0, 3)))


def test_the_true_albedo_is_that_of_the_nearest_skin_and_eyes_are_left_out() -> None:
    vertices = RNG.uniform(-0.1, 0.1, (4000, 3)) * [1, 1, 0]
    colours = np.where(vertices[:, :1] > 0, [[0.5, 0.3, 0.2]], [[0.2, 0.1, 0.1]])
    eyes = np.array([[0.05, 0.05, 0.0], [-0.05, 0.05, 0.0]])
    head = TexturedHead("plane", vertices, np.zeros((0, 3), np.int64), colours, eyes, 0.012)
    position = np.array([[[0.06, -0.05, 0.0], [-0.06, -0.05, 0.0], [0.05, 0.05, 0.001], [0.5, 0.0, 0.0], [0, 0, 0]]])
    mask = np.array([[True, True, True, True, False]])
    albedo, skin = true_albedo(head, position, mask)
    np.testing.assert_allclose(albedo[0, :2], [[0.5, 0.3, 0.2], [0.2, 0.1, 0.1]])
    assert skin.tolist() == [[True, True, False, False, False]]
