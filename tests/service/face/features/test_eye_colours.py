"""Colours of iris and white between the lids."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.face.features.eye_colours import (
    DARKEST_IRIS,
    MOST_IRIS_CHANNEL,
    MOST_IRIS_LUMA,
    eye_colours,
    likely_iris,
)
from service.face.features.iris import Iris

WHITE, SKIN, BLUE = (205, 195, 190), (170, 110, 95), (60, 90, 130)
BROWN = (48, 30, 20)


def eye_photo(
    radius: float, iris: tuple[int, int, int] = BLUE, veil: float = 0.0, skin: tuple[int, int, int] = SKIN
) -> tuple[np.ndarray, Iris]:
    """A photo of one eye: (120, 160, 3) uint8 and where its iris is; ``veil`` is linear light that the cornea adds."""
    y, x = np.indices((120, 160)) + 0.5
    turn = np.linspace(0, 2 * np.pi, 17)[:-1]
    rim = np.stack([80 + 2.4 * radius * np.cos(turn), 60 + 1.0 * radius * np.sin(turn)], 1)
    between = ((x - 80) / (2.4 * radius)) ** 2 + ((y - 60) / radius) ** 2 < 1
    distance = np.hypot(x - 85, y - 60) / radius
    cornea = (between & (distance < 1))[..., None]
    image = np.where(between[..., None], WHITE, skin)
    image = np.where(cornea, iris, image)
    image = np.where((between & (distance < 0.35))[..., None], 5, image)
    light = srgb_to_linear(image / 255) + np.where(cornea, np.float32(veil), np.float32(0))
    image = np.where((np.hypot(x - 87, y - 57) < 0.15 * radius)[..., None], 255, np.rint(255 * linear_to_srgb(light)))
    return image.astype(np.uint8), Iris(np.array([85.0, 60.0]), radius, rim, 0.5)


@pytest.mark.parametrize("radius", [3.5, 20.0])
def test_colours_of_an_eye_are_those_between_the_lids(radius: float) -> None:
    """Pupil, the lamp mirrored in it and the red lids beside it must not be mixed in."""
    photo, iris = eye_photo(radius)
    sclera, colour = eye_colours(photo, [iris])
    assert colour is not None and np.abs(colour * 255 - BLUE).max() < 12
    assert sclera is not None and np.abs(sclera * 255 - WHITE).max() < 12


def test_no_eye_has_no_colours() -> None:
    photo, iris = eye_photo(20.0)
    assert eye_colours(photo, []) == (None, None)
    lost = Iris(iris.centre, iris.radius, np.full((16, 2), np.nan), 0.5)
    assert eye_colours(photo, [lost]) == (None, None)
    beside = Iris(iris.centre + 1000, iris.radius, iris.rim + 1000, 0.5)
    assert eye_colours(photo, [beside]) == (None, None)
    red = np.full_like(photo, [170, 80, 70])
    assert eye_colours(red, [iris]) == (None, None)


def test_what_a_dark_eye_mirrors_is_not_its_colour() -> None:
    """A bright sky in the cornea is as bright as a brown iris in the shade: it came out grey and pale."""
    photo, iris = eye_photo(20.0, BROWN, veil=0.03)
    _, shown = eye_colours(photo, [iris])
    assert shown is not None and np.abs(shown * 255 - BROWN).max() < 10
    small, there = eye_photo(5.0, BROWN, veil=0.03)
    _, kept = eye_colours(small, [there])
    assert kept is not None and kept.min() > shown.min(), "its pupil is not resolved"


def test_a_black_eye_keeps_a_colour() -> None:
    """As dark as what its pupil mirrors: nothing would be left, and hue is a quotient."""
    photo, iris = eye_photo(20.0, (5, 5, 5), veil=0.02)
    _, shown = eye_colours(photo, [iris])
    assert shown is not None and np.isfinite(shown).all() and (shown > 0).all()


@pytest.mark.parametrize("skin", [SKIN, (110, 65, 45), (70, 40, 28)])
def test_a_lid_is_no_iris(skin: tuple[int, int, int]) -> None:
    """Of lowered eyes the disc lies on the lid: the eye came out orange."""
    photo, iris = eye_photo(20.0, skin, skin=skin)
    assert eye_colours(photo, [iris])[1] is None
    paler, iris = eye_photo(20.0, BLUE, skin=skin)
    assert eye_colours(paler, [iris])[1] is not None


def test_no_iris_glows_and_none_is_black() -> None:
    """Divided by a white in deep shade anything is bright; a black one would have no pupil."""
    for linear in ([9.0, 3.0, 1.0], [0.9, 0.9, 0.9], [0.0, 0.0, 0.0], [0.1, 0.05, 0.02]):
        found = likely_iris(np.array(linear, np.float32))
        assert luma(found) <= MOST_IRIS_LUMA * 1.001 and found.max() <= MOST_IRIS_CHANNEL * 1.001
        assert (found >= DARKEST_IRIS * 0.999).all()
    assert np.allclose(found, [0.1, 0.05, 0.02], atol=1e-5), "the last is a plain brown"


def test_no_iris_is_purple_and_blue_ones_stay() -> None:
    """The sky in a brown one adds blue; warm light taken off a dark one does."""
    for red, green, blue in ([0.05, 0.03, 0.06], [0.15, 0.12, 0.12], [0.02, 0.0, 0.05]):
        found = likely_iris(np.array([red, green, blue], np.float32))
        assert np.isfinite(found).all() and found[2] <= max(1.001 * found[1], DARKEST_IRIS[2]) <= 1.01 * found[0]
    for plain in ([0.12, 0.17, 0.23], [0.10, 0.12, 0.06], [0.15, 0.15, 0.15]):
        assert np.allclose(likely_iris(np.array(plain, np.float32)), plain, atol=1e-4)


def test_irises_are_not_red() -> None:
    """The light of a lamp that was not all taken off, or a flash that the back of the eye sends back."""
    for linear in ([0.084, 0.011, 0.005], [0.30, 0.05, 0.04], [0.2, 0.0, 0.0]):
        found = likely_iris(np.array(linear, np.float32))
        assert found[0] < 2.6 * found[1] and found[2] > 0.35 * found[1]
        assert luma(found) <= luma(np.array(linear, np.float32)) + 0.02
