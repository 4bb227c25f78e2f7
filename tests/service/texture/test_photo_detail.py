"""The photo's own detail on a map; blur and noise of a photo."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.arrays import Float32, UInt8
from service.geometry.chart import Chart
from service.photo.photo import Photo
from service.texture.photo_detail import (
    LEAST_BLUR,
    UNKNOWN_BLUR,
    OwnDetail,
    Sharpness,
    measure_sharpness,
    own_texture_of,
)
from service.texture.texture import Texture, make_texture
from tests.service.texture.scenes import SKIN, Array, bare, fitted, photograph, plain, turned
from tests.toyhead import sphere_head

HEAD = sphere_head(40, 60)
CHART = Chart.build(HEAD, 576, 384)
SIZE = (1536, 1024)


def spots(points: Array) -> Array:
    """Waves of 3 mm on a skin tone, the finest that a map of ``SIZE`` and a photo of 1000 pixels hold well."""
    wave = np.cos(points[:, 0] * 2 * np.pi / 0.003) * np.cos(points[:, 1] * 2 * np.pi / 0.003)
    return np.asarray(SKIN) * (1 + 0.08 * wave[:, None])


@pytest.fixture(scope="module")
def scene() -> tuple[Photo, Texture, OwnDetail]:
    photo, fit = photograph(HEAD, turned(0, 1000), spots), fitted(HEAD, turned(0, 1000))
    texture = make_texture(photo, fit, CHART, bare(HEAD, turned(0, 1000)))
    return photo, texture, OwnDetail.of(photo, HEAD, fit, texture)


def enlarged(texture: Texture, size: tuple[int, int] = SIZE) -> np.ndarray:
    large = cv2.resize(texture.texture.astype(np.uint16) * np.uint16(257), size, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large)


def truth(size: tuple[int, int] = SIZE) -> Float32:
    chart = Chart.build(HEAD, *size)
    return spots(chart.interpolate(HEAD.mean).reshape(-1, 3).astype(float)).reshape(*size[::-1], 3).astype(np.float32)


def seen_by(own: OwnDetail, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.asarray(cv2.resize(own.seen, size)) > 0.99


def test_the_map_comes_nearer_to_what_was_painted(scene: tuple[Photo, Texture, OwnDetail]) -> None:
    _, texture, own = scene
    before, after = enlarged(texture), enlarged(texture)
    told = own.onto(after)
    where, right = seen_by(own), truth()
    assert where.mean() > 0.05
    errors = [float(np.abs(codes / 65535 - right)[where].mean()) for codes in (before, after)]
    assert errors[1] < 0.5 * errors[0]
    assert told.octaves[-1].share > 0.8
    assert told.octaves[0].longest_mm == told.octaves[1].shortest_mm


def test_what_the_photo_does_not_show_stays_to_the_bit(scene: tuple[Photo, Texture, OwnDetail]) -> None:
    _, texture, own = scene
    before, after = enlarged(texture), enlarged(texture)
    own.onto(after)
    hidden = cv2.dilate(np.asarray(cv2.resize(own.seen, SIZE)), np.ones((65, 65), np.uint8)) == 0
    assert hidden.mean() > 0.1
    assert (before[hidden] == after[hidden]).all()


def test_a_photo_that_shows_no_head_changes_nothing() -> None:
    camera = turned(0)
    away = type(camera)(400, 400, camera.focal_px, np.array([9000.0, 200.0]), camera.rotation, camera.translation)
    photo, fit = Photo(np.full((400, 400, 3), 90, np.uint8)), fitted(HEAD, away)
    texture = make_texture(photo, fit, CHART)
    own, codes = OwnDetail.of(photo, HEAD, fit, texture), enlarged(texture)
    told = own.onto(codes)
    assert (codes == enlarged(texture)).all()
    assert all(one.share == 0 for one in told.octaves)
    assert told.pixels_per_mm == {}
    assert own.texture_size() == (576, 384)
    assert own_texture_of(texture, own, (576, 384)) is None


def test_the_texture_is_as_large_as_the_photo_holds(scene: tuple[Photo, Texture, OwnDetail]) -> None:
    _, _, own = scene
    sharp = replace(own, sharpness=Sharpness(LEAST_BLUR, 0.001))
    assert sharp.texture_size() == (4608, 3072)  # the toy face lies closer on its chart than ours
    assert own.texture_size() == (2304, 1536)  # waves have no sharp edges: they count as somewhat blurred
    assert own.texture_size(2000) == (1152, 768)
    assert own.texture_size(576) == (576, 384)
    small = photograph(HEAD, turned(0, 150), plain(SKIN))
    fit = fitted(HEAD, turned(0, 150))
    coarse = make_texture(small, fit, CHART)
    assert OwnDetail.of(small, HEAD, fit, coarse).texture_size() == (576, 384)


SHARP, FIT = photograph(HEAD, turned(0, 1000), spots), fitted(HEAD, turned(0, 1000))


def own_of(photo: Photo) -> tuple[Texture, OwnDetail]:
    texture = make_texture(photo, FIT, CHART, bare(HEAD, turned(0, 1000)))
    return texture, OwnDetail.of(photo, HEAD, FIT, texture)


def test_what_glasses_cover_stays_to_the_bit() -> None:
    texture, _ = own_of(SHARP)
    confidence = texture.confidence.copy()
    confidence[150:230, 200:280] = 0
    hidden = replace(texture, confidence=confidence)
    own, before, after = OwnDetail.of(SHARP, HEAD, FIT, hidden), enlarged(texture), enlarged(texture)
    own.onto(after)
    scale = SIZE[0] / 576
    place = tuple(slice(int(low * scale), int(high * scale)) for low, high in ((165, 215), (215, 265)))
    assert (before[place] == after[place]).all()
    assert (before != after).any()


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


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_the_noise_is_found(noise: float) -> None:
    assert measure_sharpness(edges(1.0, noise)).noise == pytest.approx(noise, rel=0.2)


@pytest.mark.parametrize("image", [np.full((200, 200, 3), 128, np.uint8), np.zeros((0, 0, 3), np.uint8)])
def test_a_picture_without_edges_counts_as_blurred(image: UInt8) -> None:
    assert measure_sharpness(image).blur == UNKNOWN_BLUR


def test_coarse_steps_of_jpeg_are_noise() -> None:
    steps = np.full((8, 8), 40 / 255, np.float32)
    frequency = np.array([0.05, 0.2])
    plain, coded = (Sharpness(0.5, 0.003, table).noise_power(frequency) for table in (None, steps))
    assert (coded > 10 * plain).all()


@pytest.mark.parametrize("size", [(1536, 1024), (1203, 802), (288, 192)])
def test_a_texture_has_the_size_that_was_asked_for(
    scene: tuple[Photo, Texture, OwnDetail], size: tuple[int, int]
) -> None:
    _, texture, own = scene
    made = own_texture_of(texture, own, size)
    assert made is not None
    assert made.shape == (size[1], size[0], 3)
    error = np.abs(made / 255 - truth(size))[seen_by(own, size)].mean()
    assert error < (0.02 if size[0] > 576 else 0.03)
