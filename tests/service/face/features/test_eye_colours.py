"""Colours of iris and white between the lids."""

from __future__ import annotations

import numpy as np

from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.face.features.eye_colours import (
    eye_colours,
    iris_without_light,
    likely_iris,
)
from service.face.features.iris import Iris

WHITE, SKIN, BLUE = (205, 195, 190), (170, 110, 95), (60, 90, 130)
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


def test_no_eye_has_no_colours() -> None:
    photo, iris = eye_photo(20.0)
    assert eye_colours(photo, []) == (None, None)
    lost = Iris(iris.centre, iris.radius, np.full((16, 2), np.nan), 0.5)
    assert eye_colours(photo, [lost]) == (None, None)
    beside = Iris(iris.centre + 1000, iris.radius, iris.rim + 1000, 0.5)
    assert eye_colours(photo, [beside]) == (None, None)
    red = np.full_like(photo, [170, 80, 70])
    assert eye_colours(red, [iris]) == (None, None)


def test_a_black_eye_keeps_a_colour() -> None:
    """As dark as what its pupil mirrors: nothing would be left, and hue is a quotient."""
    photo, iris = eye_photo(20.0, (5, 5, 5), veil=0.02)
    _, shown = eye_colours(photo, [iris])
    assert shown is not None and np.isfinite(shown).all() and (shown > 0).all()


def test_irises_are_not_red() -> None:
    """The light of a lamp that was not all taken off, or a flash that the back of the eye sends back."""
    for linear in ([0.084, 0.011, 0.005], [0.30, 0.05, 0.04], [0.2, 0.0, 0.0]):
        found = likely_iris(np.array(linear, np.float32))
        assert found[0] < 2.6 * found[1] and found[2] > 0.35 * found[1]
        assert luma(found) <= luma(np.array(linear, np.float32)) + 0.02


def test_irises_of_a_photo_without_colour_are_brown_and_as_dark_as_they_are_shown() -> None:
    """They were blue: grey in a light that makes skin grey, which is blue."""
    blue_light = np.array([0.8, 1.0, 1.3], np.float32)
    dark, bright = (iris_without_light(np.full(3, level, np.float32), blue_light) for level in (0.2, 0.35))
    for iris in (dark, bright):
        assert iris[0] > iris[1] > iris[2]
    assert bright[1] > 1.5 * dark[1]
    seen = iris_without_light(np.array([0.3, 0.36, 0.42], np.float32), np.ones(3, np.float32))
    assert seen[2] > seen[0], "in colour, blue ones are blue"
    black = iris_without_light(np.zeros(3, np.float32), blue_light)
    assert np.isfinite(black).all() and (black > 0).all()
