"""Blur and noise of a photo."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.arrays import UInt8
from service.texture.sharpness import LEAST_BLUR, UNKNOWN_BLUR, Sharpness, measure_sharpness


def edges(blur: float, noise: float, seed: int = 0, side: int = 400) -> UInt8:
    """Discs of two tones on a third, drawn at four times the size, blurred, with noise."""
    rng = np.random.default_rng(seed)
    large = np.full((4 * side, 4 * side), 0.5, np.float32)
    for x, y, r, tone in zip(*rng.uniform(0, 4 * side, (2, 40)), rng.uniform(40, 160, 40), rng.uniform(0.3, 0.7, 40),
                             strict=True):  # fmt: skip
        cv2.circle(large, (int(x), int(y)), int(r), float(tone), -1)
    image = cv2.resize(large, (side, side), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    image = image + rng.normal(0, noise, image.shape)
    return np.repeat(np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)[..., None], 3, 2)


@pytest.mark.parametrize("blur", [0.8, 1.5, 3.0])
def test_the_blur_is_found(blur: float) -> None:
    assert measure_sharpness(edges(blur, 0.003)).blur == pytest.approx(np.hypot(blur, 0.3), rel=0.25)


def test_a_sharp_picture_is_sharp_and_an_enlarged_one_is_not() -> None:
    sharp = edges(0, 0.003)
    large = cv2.resize(sharp, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    assert measure_sharpness(sharp).blur < 0.6
    assert measure_sharpness(np.asarray(large, np.uint8)).blur > 2 * measure_sharpness(sharp).blur


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_the_noise_is_found(noise: float) -> None:
    assert measure_sharpness(edges(1.0, noise)).noise == pytest.approx(noise, rel=0.2)


@pytest.mark.parametrize("image", [np.full((200, 200, 3), 128, np.uint8), np.zeros((0, 0, 3), np.uint8)])
def test_a_picture_without_edges_counts_as_blurred(image: UInt8) -> None:
    assert measure_sharpness(image).blur == UNKNOWN_BLUR


def test_nothing_is_resolved_beyond_half_a_cycle_a_pixel() -> None:
    left = Sharpness(LEAST_BLUR, 0.0).resolved(np.array([0.0, 0.1, 0.49, 0.5, 3.0]))
    assert left[0] == 1
    assert left[3] == left[4] == 0
    assert (np.diff(left) <= 0).all()


def test_coarse_steps_of_jpeg_are_noise() -> None:
    steps = np.full((8, 8), 40 / 255, np.float32)
    frequency = np.array([0.05, 0.2])
    plain, coded = (Sharpness(0.5, 0.003, table).noise_power(frequency) for table in (None, steps))
    assert (coded > 10 * plain).all()
