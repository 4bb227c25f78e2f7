"""The iris between the lids, the direction it means, the eyes that are turned to it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.face.features.iris import Iris, search

TURN = np.linspace(0, 2 * np.pi, 17)[:-1]

AHEAD = np.array([0.0, 0.0, 1.0])


def find_iris(image: np.ndarray, rim: np.ndarray, radius: float) -> Iris | None:
    """The iris of one eye by itself."""
    found = search(image, rim, radius)
    return None if found is None else found.best()


def almond(middle: np.ndarray, radius: float) -> np.ndarray:
    """(16, 2) rim of an open eye: 28 mm by 11 mm where the iris has 11.7."""
    return np.asarray(middle + radius * np.stack([2.4 * np.cos(TURN), 0.95 * np.sin(TURN)], 1))


def draw(image: np.ndarray, rim: np.ndarray, centre: np.ndarray, radius: float, iris: tuple[int, int, int]) -> None:
    """Sclera, iris, pupil and a mirrored lamp, all cut off by the lids."""
    eye = np.full_like(image, (205, 196, 190))
    for size, colour in ((1.0, iris), (0.35, (10, 8, 8))):
        at = tuple(np.rint((centre - 0.5) * 16).astype(int).tolist())
        cv2.circle(eye, at, round(size * radius * 16), colour, -1, cv2.LINE_AA, 4)
    if radius > 5:
        lamp = tuple(np.rint(centre + 0.2 * radius).astype(int).tolist())
        cv2.circle(eye, lamp, round(0.15 * radius), (255, 255, 255), -1)
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint((rim - 0.5) * 16).astype(np.int32)], 1, shift=4)
    image[mask > 0] = eye[mask > 0]


@pytest.mark.parametrize("radius", [3.0, 9.0, 40.0])
@pytest.mark.parametrize("iris", [(70, 45, 30), (95, 125, 160)])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.8, 0.1), (-1.1, -0.2)])
def test_iris_is_found_where_it_is(radius: float, iris: tuple[int, int, int], offset: tuple[float, float]) -> None:
    """Small and large, brown and blue: half a pixel wrong in the patch's matrix would show at radius 3."""
    image = np.full((400, 600, 3), (190, 140, 120), np.uint8)
    middle = np.array([301.3, 198.6])
    rim = almond(middle, radius)
    centre = middle + radius * np.array(offset)
    draw(image, rim, centre, radius, iris)
    found = find_iris(image, rim, radius)
    assert found is not None
    assert np.abs(found.centre - centre)[0] < 0.12 * radius + 0.15
    assert np.abs(found.centre - centre)[1] < 0.2 * radius + 0.15


def test_nothing_is_found_where_there_is_nothing() -> None:
    """Blank skin has no range of values to divide by; the others have no pixels to read."""
    blank = np.full((100, 100, 3), 140, np.uint8)
    rim = almond(np.array([50.0, 50.0]), 8.0)
    assert find_iris(blank, rim, 8.0) is None
    noisy = np.random.default_rng(0).normal(140, 6, blank.shape).clip(0, 255).astype(np.uint8)
    assert find_iris(noisy, rim, 8.0) is None
    drawn = blank.copy()
    draw(drawn, rim, np.array([50.0, 50.0]), 8.0, (60, 40, 30))
    for bad in (rim + 60, rim - 60, rim + 1e9, np.full_like(rim, np.nan)):
        assert find_iris(drawn, bad, 8.0) is None
    for radius in (0.0, -1.0, 1.0, np.nan):
        assert find_iris(drawn, rim, radius) is None
    closed = rim * [1, 0.0] + [0, 50]
    assert find_iris(drawn, closed, 8.0) is None
