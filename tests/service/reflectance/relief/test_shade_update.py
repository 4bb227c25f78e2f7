"""Shade corrects normals along the light by the share that pigment leaves, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.chart import Chart
from service.light.formulas import LUMINANCE, sh_basis
from service.reflectance.reflectance_maps import NORMAL_ONE
from service.reflectance.relief.normal_inputs import GAMMA, PIGMENT, RELIEF, UNTOLD, updated, with_shade
from service.reflectance.subject import sensitivity
from tests.toyhead import sphere_head

WIDTH, HEIGHT = 6144, 256
PERIOD = 12
"""Texels: in the third octave."""
LIGHT = np.array([0.9, 0.0], np.float32)
OCTAVES = (1.0, 1.0, 1.0, 1.0)
X = np.arange(WIDTH)
TILT = 0.05 * np.cos(2 * np.pi * X / PERIOD)


def test_one_texel_is_the_gaussian_s_mean() -> None:
    """Two observations of x, the guess and the shade, each by the inverse of its variance; y has the guess alone."""
    guess, truth, slope, error, pigment = 0.02, 0.05, 0.8, 0.03, 0.02
    normal = np.array([[[guess, 0.01]]], np.float32)
    shade = np.array([[slope * truth]], np.float32)
    change = updated(normal, shade, (slope, 0.0), error, pigment)
    by_shade, by_guess = (slope / pigment) ** 2, 1 / error**2
    assert guess + change[0, 0, 0] == pytest.approx((by_shade * truth + by_guess * guess) / (by_shade + by_guess))
    assert change[0, 0, 1] == 0


def waves() -> tuple[np.ndarray, np.ndarray]:
    """Codes of grey skin with a tilt of ``TILT`` along x in a light from there, and of flat normals."""
    coded = 0.5 * np.exp(LIGHT[0] * TILT / GAMMA)
    grey = np.broadcast_to(np.rint(65535 * coded).astype(np.uint16), (HEIGHT, WIDTH)).copy()
    return grey, np.zeros((HEIGHT, WIDTH, 2), np.int16)


def planes(trust: float = 1.0, slope: np.ndarray = LIGHT) -> tuple[np.ndarray, np.ndarray]:
    return np.broadcast_to(slope, (16, 96, 2)).astype(np.float32), np.full((16, 96), trust, np.float32)


def test_waves_in_a_known_light_come_back_by_the_closed_form() -> None:
    grey, flat = waves()
    found = with_shade(flat, grey, *planes(), OCTAVES)[HEIGHT // 2] / NORMAL_ONE
    inside = slice(600, WIDTH - 600)
    share = float((found[inside, 0] * TILT[inside]).sum() / (TILT[inside] ** 2).sum())
    squares = [((LIGHT[0] * UNTOLD * r) ** 2, p * p) for r, p in zip(RELIEF, PIGMENT, strict=True)]
    expected = [relief / (relief + pigment) for relief, pigment in squares]
    assert min(expected[1:4]) - 0.03 < share < max(expected[1:4]) + 0.03
    assert np.corrcoef(found[inside, 0], TILT[inside])[0, 1] > 0.97
    assert np.abs(found[..., 1]).max() < 1e-3


@pytest.mark.parametrize("still", [planes(trust=0.0), planes(slope=np.zeros(2))])
def test_without_trust_or_direction_nothing_changes(still: tuple[np.ndarray, np.ndarray]) -> None:
    grey, flat = waves()
    assert not with_shade(flat, grey, *still, OCTAVES).any()


def test_the_light_s_answer_is_the_derivative_of_its_logarithm() -> None:
    head = sphere_head(40, 60)
    chart = Chart.build(head, 192, 128)
    light = np.zeros((9, 3))
    light[0], light[3], light[1] = 3.0, 0.8, 0.5
    frame, turn = chart.frame(head.mean), np.eye(3)
    found = sensitivity(chart, head.mean, light, turn)
    inside = chart.texels[:: max(len(chart.texels) // 50, 1)]
    normal, along = (axis.reshape(-1, 3)[inside].astype(float) for axis in (frame.normal, frame.tangent))
    step = 1e-4
    grey = light @ LUMINANCE
    values = [np.log(sh_basis(normal + side * step * along) @ grey) for side in (1, -1)]
    assert np.abs(found.reshape(-1, 2)[inside, 0] - (values[0] - values[1]) / (2 * step)).max() < 1e-3
