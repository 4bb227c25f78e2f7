"""Grey and tinted photos are told from coloured ones."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from service.photo.photo import lacks_colour
from tests.service.photo import badimages as bad

PICTURE = bad.picture(400, 300)
GREY = PICTURE.mean(axis=2, keepdims=True)


def as_pixels(values: np.ndarray) -> bad.Pixels:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def test_colour() -> None:
    assert not lacks_colour(PICTURE)


def test_grey() -> None:
    assert lacks_colour(as_pixels(GREY.repeat(3, axis=2)))


@pytest.mark.parametrize("tint", [(1.0, 0.97, 0.93), (1.0, 0.85, 0.65), (0.75, 0.85, 1.0)])
def test_tinted_prints(tint: tuple[float, float, float]) -> None:
    """Sepia and cyanotype: colours far from grey, but only one for each lightness."""
    assert lacks_colour(as_pixels(GREY * tint))


def test_tint_that_changes_with_lightness() -> None:
    shadows, lights = np.array([20, 30, 60]), np.array([255, 240, 215])
    assert lacks_colour(as_pixels(shadows + GREY / 255 * (lights - shadows)))


@pytest.mark.parametrize("quality", [50, 90])
def test_tinted_print_after_jpeg(quality: int) -> None:
    sepia = as_pixels(np.clip(GREY + np.random.default_rng(1).normal(0, 6, GREY.shape), 0, 255) * (1, 0.88, 0.7))
    assert lacks_colour(np.asarray(Image.open(io.BytesIO(bad.save(sepia, "JPEG", quality=quality)))))


def test_one_skin_colour_before_a_grey_wall_is_colour() -> None:
    """A render of one albedo: its colour follows its lightness as in a sepia print, but the wall's does not."""
    wall = np.full((300, 300, 3), 140, np.uint8)
    wall[60:240, 60:240] = as_pixels(GREY[:180, :180] / 255 * (225, 170, 140))
    assert not lacks_colour(wall)


def test_small_coloured_face_before_a_white_wall_is_colour() -> None:
    wall = np.full((600, 600, 3), 245, np.uint8)
    wall[250:330, 260:330] = bad.picture(70, 80) // 3 + np.array([120, 70, 50], np.uint8)
    assert not lacks_colour(wall)


def test_noise_of_a_sensor_is_not_colour() -> None:
    noisy = GREY + np.random.default_rng(0).normal(0, 3, PICTURE.shape)
    assert lacks_colour(as_pixels(noisy))


@pytest.mark.parametrize("value", [0, 128, 255])
def test_one_flat_value(value: int) -> None:
    """No lightness to fit against: the fit is singular and must still give an answer."""
    assert lacks_colour(np.full((64, 64, 3), value, np.uint8))


@pytest.mark.parametrize("shape", [(64, 64), (64, 384), (3000, 64), (1, 1)])
def test_any_shape(shape: tuple[int, int]) -> None:
    assert lacks_colour(np.full((*shape, 3), 90, np.uint8))


def test_pixels_are_left_alone() -> None:
    before = PICTURE.copy()
    lacks_colour(PICTURE)
    assert np.array_equal(before, PICTURE)
