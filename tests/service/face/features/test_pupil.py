"""Pupils are measured where a photo resolves them, and nothing is told where it does not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.face.features.iris import RESOLVED_IRIS_PX, Iris, pupil_radius
from service.head.eyeball import IRIS_RADIUS_M

BLUE, BROWN, BLACK = (110, 140, 150), (88, 58, 40), (24, 18, 16)


def photo(
    share: float | tuple[float, float], iris: tuple[int, int, int] = BLUE, radius: float = 14.0, blur: float = 0.7,
    glint: bool = True,
) -> tuple[np.ndarray, list[Iris]]:  # fmt: skip
    """Two eyes in eight times the resolution, made smaller, with noise, a limbus, a lid's shade and a mirrored lamp."""
    scale, size = 8, (120, 240)
    image: np.ndarray = np.full((size[0] * scale, size[1] * scale, 3), (190, 140, 120), np.float32)
    irises = []
    for x, own in zip((60.3, 180.6), (share, share) if isinstance(share, float) else share, strict=True):
        centre = np.array([x, 58.4])
        angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        rim = centre + radius * np.stack([1.9 * np.cos(angle), 0.9 * np.sin(angle)], 1)
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.fillPoly(mask, [np.rint(rim * scale).astype(np.int32)], 1)
        row, column = (np.indices(mask.shape) + 0.5) / scale
        away = np.hypot(column - centre[0], row - centre[1]) / radius
        limbus = (1 - 0.4 * np.clip(away - 0.8, 0, 1) / 0.2)[..., None]
        eye = np.where(away[..., None] < 1, np.array(iris) * limbus, 225)
        eye = np.where(np.hypot(column - centre[0] - 0.05 * radius, row - centre[1])[..., None] < own * radius, 9, eye)
        if glint:
            lamp = (np.abs(column - centre[0] + 0.2 * radius) < 0.15 * radius) & (
                np.abs(row - centre[1] + 0.2 * radius) < 0.15 * radius
            )
            eye = np.where(lamp[..., None], 255, eye)
        shade = np.clip(0.5 + (row - centre[1] + 0.9 * radius) / (0.5 * radius), 0, 1)[..., None]
        image = np.where(mask[..., None] > 0, eye * shade, image)
        irises.append(Iris(centre, radius, rim, 0.8))
    image = cv2.GaussianBlur(image, (0, 0), blur * scale)
    small = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)
    noisy = small + np.random.default_rng(3).normal(0, 2, small.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), irises


@pytest.mark.parametrize("share", [0.33, 0.4, 0.5, 0.55])
@pytest.mark.parametrize("colour", [BLUE, BROWN])
@pytest.mark.parametrize("radius", [14.0, 25.0])
def test_pupils_come_back(share: float, colour: tuple[int, int, int], radius: float) -> None:
    found = pupil_radius(*photo(share, colour, radius))
    assert found is not None and found == pytest.approx(share * IRIS_RADIUS_M, abs=0.075 * IRIS_RADIUS_M)


def test_nothing_is_told_of_black_small_blurred_or_unlike_eyes() -> None:
    assert pupil_radius(*photo(0.4, BLACK)) is None
    assert pupil_radius(*photo(0.4, radius=0.9 * RESOLVED_IRIS_PX)) is None
    assert pupil_radius(*photo(0.22, BROWN, radius=11.0, blur=5.0)) is None
    assert pupil_radius(*photo((0.3, 0.5))) is None
    assert pupil_radius(*photo(0.02)) is None, "an iris without a pupil"
    image, irises = photo(0.4)
    assert pupil_radius(image, irises[:1]) is None and pupil_radius(image, ()) is None


def test_an_eye_beside_the_photo_or_without_a_rim_tells_nothing() -> None:
    image, irises = photo(0.4)
    for shift in (-60.0, 500.0, np.nan):
        moved = [Iris(one.centre + np.nan_to_num(shift), one.radius, one.rim + shift, 0.8) for one in irises]
        assert pupil_radius(image, moved) is None
