"""Eyes and teeth together."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import LUMA
from service.face.features.eye_colours import (
    BETWEEN_LIDS,
    CHEEKS,
    RANGE,
    cheek_colour,
    light_from_sclera_and_teeth,
    palest,
)
from service.face.features.mouth import TOOTH, measure_teeth
from tests.service.face.features.test_sclera import MEAN, photo_of
from tests.service.face.features.test_teeth import RIM, SKINS, mouth

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


def test_a_white_in_the_shade_tells_how_strong_the_light_is_but_not_its_hue() -> None:
    """A lamp from one side leaves the other eye what the skin around it sends. The lit eye alone says twice the light
    of the face, and skin comes out dark."""
    shade = 0.25 * LIGHT * [1.0, 0.8, 0.67]
    found = palest(np.array([LIGHT, shade]))
    assert np.allclose(found / LIGHT, (found / LIGHT)[0]), "the hue of the lit one"
    assert np.isclose(found @ LUMA, np.sqrt((LIGHT @ LUMA) * (shade @ LUMA)), rtol=0.02)


def test_teeth_speak_for_closed_eyes() -> None:
    pixels, skin = mouth(TOOTH, LIGHT, np.array(SKINS["brown"]))
    cheek = np.asarray(skin, np.float32)
    found = light_from_sclera_and_teeth(pixels, None, measure_teeth(pixels, RIM, cheek), cheek)
    assert found is not None and np.abs(np.log(found / (LIGHT * BETWEEN_LIDS))).max() < 0.06
    assert light_from_sclera_and_teeth(pixels, None, None, cheek) is None
    assert light_from_sclera_and_teeth(pixels, None, np.ones(3, np.float32), None) is None


def test_eyes_speak_for_a_closed_mouth() -> None:
    pixels, gaze = photo_of(LIGHT, 15.0)
    found = light_from_sclera_and_teeth(pixels, gaze, None, np.array([0.7, 0.5, 0.4], np.float32))
    assert found is not None and np.abs(np.log(found / (LIGHT * MEAN))).max() < 0.15


@pytest.mark.parametrize("radius", [0.0, 5.0, 400.0, np.nan])
def test_cheeks_at_the_border_and_beyond(radius: float) -> None:
    """A patch reaches out of the photo, is empty, or has no size."""
    pixels = np.full((40, 60, 3), 51, np.uint8)
    at = landmarks_at([(0.0, 39.9), (-50.0, 10.0)])
    found = cheek_colour(pixels, at, radius / 0.12)
    assert found is None or np.allclose(found, 0.2)
    assert cheek_colour(pixels, landmarks_at([(-50.0, -50.0), (999.0, 10.0)]), 10.0) is None
