"""The light that the whites of the eyes show."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.colour import linear_to_srgb, to_bytes
from service.face.features.eye_colours import (
    BEST_LIT,
    BETWEEN_LIDS,
    SCLERA,
    sclera_light,
)
from service.face.features.eyes import Gaze
from service.face.features.iris import Iris

SKIN = np.array([0.12, 0.055, 0.035])
MEAN = BETWEEN_LIDS / BEST_LIT
"""Light on the whole of the white over that on its best lit part, which is what is seen here."""
TURN = np.linspace(0, 2 * np.pi, 17)[:-1]


def photo_of(light: np.ndarray, radius: float, *, iris_at: float = 0.0, glint: bool = False) -> tuple[np.ndarray, Gaze]:
    """A face of dark skin with one open eye, whose white lies in a light of linear RGB."""
    middle = np.array([160.4, 119.7])
    rim = middle + radius * np.stack([2.4 * np.cos(TURN), 0.95 * np.sin(TURN)], 1)
    image, eye = (np.empty((240, 320, 3), np.uint8) for _ in range(2))
    image[:] = to_bytes(linear_to_srgb(SKIN * light))
    eye[:] = to_bytes(linear_to_srgb(SCLERA * light))
    centre = middle + np.array([iris_at * radius, 0.0])
    at = tuple(np.rint((centre - 0.5) * 16).astype(int).tolist())
    cv2.circle(eye, at, round(radius * 16), (52, 34, 26), -1, cv2.LINE_AA, 4)
    if glint:
        cv2.circle(
            eye, tuple(np.rint(middle + np.array([1.6 * radius, 0.0])).astype(int).tolist()), 2, (255, 255, 255), -1
        )
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint((rim - 0.5) * 16).astype(np.int32)], 1, shift=4)
    image[mask > 0] = eye[mask > 0]
    return cv2.GaussianBlur(image, (0, 0), 0.6), Gaze(0.0, 0.0, (Iris(centre, radius, rim, 0.8),))


@pytest.mark.parametrize("light", [(0.9, 0.8, 0.7), (0.05, 0.06, 0.09), (0.4, 0.3, 0.1)])
@pytest.mark.parametrize("radius", [6.0, 20.0])
@pytest.mark.parametrize("iris_at", [0.0, 0.8])
def test_light_of_the_white_is_measured(light: tuple[float, ...], radius: float, iris_at: float) -> None:
    """Bright, dim and coloured; were iris, lashes or lids counted, dim would be what is only dark."""
    pixels, gaze = photo_of(np.array(light), radius, iris_at=iris_at)
    found = sclera_light(pixels, gaze.irises[0])
    assert found is not None
    assert np.abs(np.log(found / (np.array(light) * MEAN))).max() < 0.15


def test_nothing_seen_is_none() -> None:
    """An eye of few pixels, a black and an overexposed photo, an eye beyond the border."""
    pixels, gaze = photo_of(np.array([0.5, 0.5, 0.5]), 12.0)
    small, tiny = photo_of(np.array([0.5, 0.5, 0.5]), 1.5)
    assert sclera_light(small, tiny.irises[0]) is None
    for value in (0, 255):
        assert sclera_light(np.full_like(pixels, value), gaze.irises[0]) is None
    iris = gaze.irises[0]
    away = Iris(iris.centre + 900.0, iris.radius, iris.rim + 900.0, iris.contrast)
    assert sclera_light(pixels, away) is None
