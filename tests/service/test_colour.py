"""Colour against published values and against itself."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import bytes_to_linear, linear_to_lab, linear_to_srgb, srgb_to_linear
from service.robust import geman_mcclure


def test_linear_values_follow_the_standard() -> None:
    """Middle code 128 is 21.586 % of white, and below the knee the curve is a straight line."""
    assert bytes_to_linear(np.array([128], np.uint8))[0] == pytest.approx(0.21586, abs=1e-5)
    assert srgb_to_linear(np.array([0.04]))[0] == pytest.approx(0.04 / 12.92, rel=1e-6)


def test_both_curves_grow_and_meet_at_the_knee() -> None:
    x = np.linspace(0, 1, 10001)
    for curve in (srgb_to_linear, linear_to_srgb):
        y = curve(x)
        assert (np.diff(y) > 0).all()
        assert np.abs(np.diff(y)).max() < 0.0015
        assert y.dtype == np.float32


@pytest.mark.parametrize(
    ("rgb", "lab"),
    [
        ([255, 255, 255], [100, 0, 0]),
        ([0, 0, 0], [0, 0, 0]),
        ([255, 0, 0], [53.24, 80.09, 67.20]),
        ([0, 0, 255], [32.30, 79.19, -107.86]),
        ([119, 119, 119], [50.03, 0, 0]),
    ],
)
def test_lab_of_known_colours(rgb: list[int], lab: list[float]) -> None:
    assert np.allclose(linear_to_lab(srgb_to_linear(np.array([rgb]) / 255)), [lab], atol=0.05)


def test_weights_of_residuals_fall_from_one_and_do_not_depend_on_the_sign() -> None:
    weights = geman_mcclure(np.array([0.0, -2.0, 2.0, 200.0]), 2.0)
    np.testing.assert_allclose(weights[:3], [1.0, 0.25, 0.25])
    assert 0 < weights[3] < 1e-7
