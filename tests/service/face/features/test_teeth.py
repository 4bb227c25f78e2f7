"""The light that teeth show, alone and together with eyes, and what is no tooth."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import linear_to_srgb, to_bytes
from service.face.features.eye_colours import (
    CHEEKS,
    RANGE,
    cheek_colour,
    palest,
)
from service.face.features.mouth import TOOTH, measure_teeth, teeth_light

RIM = np.array([[20, 30], [40, 20], [60, 18], [80, 20], [100, 30], [80, 42], [60, 45], [40, 42]], float)
SKINS = {"dark": [0.12, 0.055, 0.035], "brown": [0.30, 0.17, 0.11], "light": [0.55, 0.36, 0.27]}
def mouth(inside: np.ndarray, light: np.ndarray, skin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lips in a light with something between them, and the colour of the skin in that light."""

    def shown(albedo: np.ndarray) -> np.ndarray:
        return to_bytes(linear_to_srgb(albedo * light))

    image = np.empty((64, 128, 3), np.uint8)
    image[:] = shown(skin * [1.0, 0.55, 0.6])
    image[22:38, 30:90] = shown(inside)
    return image, shown(skin) / 255


def light_between(pixels: np.ndarray, rim: np.ndarray, skin: np.ndarray) -> np.ndarray | None:
    """As the fit goes about it."""
    tooth = measure_teeth(pixels, rim, skin)
    return None if tooth is None else teeth_light(tooth, skin)


@pytest.mark.parametrize("rim", [RIM + 500, np.full_like(RIM, np.nan), np.repeat(RIM[:1], 8, 0)])
def test_no_mouth_no_light(rim: np.ndarray) -> None:
    """A mouth beyond the border, lost, or shut."""
    pixels, usual = mouth(TOOTH, np.ones(3) * 0.5, np.array(SKINS["light"]))
    assert light_between(pixels, rim, usual) is None


def test_black_and_overexposed_photos_tell_nothing() -> None:
    """Ratios of nothing, and white that is only the end of the scale."""
    for value in (0, 255):
        pixels = np.full((64, 128, 3), value, np.uint8)
        for skin in (np.zeros(3), np.ones(3), np.array([0.7, 0.5, 0.4])):
            assert light_between(pixels, RIM, skin) is None


LIGHT = np.array([0.5, 0.4, 0.3])


def landmarks_at(points: list[tuple[float, float]]) -> np.ndarray:
    found = np.full((468, 2), np.nan)
    found[list(CHEEKS)] = points
    return found


def test_what_is_redder_than_the_palest_does_not_count() -> None:
    """Lids in place of the white would else make half of the light."""
    assert np.allclose(palest(np.array([LIGHT, LIGHT * [1.0, 0.5, 0.4]])), LIGHT)
    assert np.allclose(palest(np.array([LIGHT, 4 * LIGHT])), 2 * LIGHT)
    assert np.allclose(palest(np.array([[90.0, 90.0, 90.0]])), RANGE[1])


@pytest.mark.parametrize("radius", [0.0, 5.0, 400.0, np.nan])
def test_cheeks_at_the_border_and_beyond(radius: float) -> None:
    """A patch reaches out of the photo, is empty, or has no size."""
    pixels = np.full((40, 60, 3), 51, np.uint8)
    at = landmarks_at([(0.0, 39.9), (-50.0, 10.0)])
    found = cheek_colour(pixels, at, radius / 0.12)
    assert found is None or np.allclose(found, 0.2)
    assert cheek_colour(pixels, landmarks_at([(-50.0, -50.0), (999.0, 10.0)]), 10.0) is None
