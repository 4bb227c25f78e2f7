"""The iris between the lids, the direction it means, the eyes that are turned to it, and how wide pupils are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.face.features.eyes import Gaze
from service.face.features.iris import RESOLVED_IRIS_PX, Iris, pupil_radius, search
from service.face.features.rims import RIMS
from service.geometry.camera import Camera, exp_rotation
from service.head.eyeball import IRIS_RADIUS_M, SIDES, eyeball
from service.head.model import HeadModel

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


def scene(
    head: HeadModel, gaze: Gaze, yaw: float, hide: tuple[str, ...] = (), roll: float = 0.0
) -> tuple[np.ndarray, np.ndarray, Camera]:
    """Photo, landmarks and camera of a head that looks somewhere; hidden eyes are skin."""
    tilt = exp_rotation(np.radians([0.0, 0.0, roll]))
    rotation = tilt @ np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.radians([0.0, yaw, 0.0]))
    camera = Camera(800, 600, 1500.0, np.array([400.0, 300.0]), rotation, np.array([0.0, 0.0, 1.0]))
    image = np.full((600, 800, 3), (190, 140, 120), np.uint8)
    landmarks = np.full((468, 3), 300.0)
    turned = np.radians([gaze.yaw_deg, gaze.pitch_deg])
    ray = np.array([np.sin(turned[0]) * np.cos(turned[1]), np.sin(turned[1]), np.cos(turned[0]) * np.cos(turned[1])])
    for side in SIDES:
        ball = eyeball(head, head.mean, side)
        assert ball is not None
        ahead, pole = camera.project(np.stack([ball.centre + ball.radius * AHEAD, ball.centre + ball.radius * ray]))
        rim = (almond(ahead, 8.8) - ahead) @ tilt[:2, :2].T + ahead
        landmarks[list(RIMS[side]), :2] = rim
        if side not in hide:
            draw(image, rim, pole, 8.8, (70, 50, 35))
    return image, landmarks, camera


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


@pytest.mark.parametrize("share", [0.33, 0.55])
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
