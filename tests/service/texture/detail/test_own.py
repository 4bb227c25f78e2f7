"""The photo's detail on a map of the toy head: where the photo shows it, as much as it holds, nothing coarser."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.arrays import Float32
from service.geometry.chart import Chart
from service.photo.photo import Photo
from service.texture import photo_sampling
from service.texture.photo_detail import Detail, OwnDetail, own_texture_of
from service.texture.photo_sampling import Reader
from service.texture.sharpness import LEAST_BLUR, Sharpness
from service.texture.texture import make_texture
from service.texture.texture_maps import Texture
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
    texture = make_texture(photo, HEAD, fit, CHART, bare(HEAD, turned(0, 1000)))
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


def test_low_frequencies_stay(scene: tuple[Photo, Texture, OwnDetail]) -> None:
    _, texture, own = scene
    before, after = enlarged(texture), enlarged(texture)
    own.onto(after)
    low = [cv2.resize(codes, (72, 48), interpolation=cv2.INTER_AREA).astype(float) / 257 for codes in (before, after)]
    assert np.abs(low[0] - low[1]).max() < 1.5


def test_strips_do_not_show(scene: tuple[Photo, Texture, OwnDetail], monkeypatch: pytest.MonkeyPatch) -> None:
    _, texture, own = scene
    whole, cut = enlarged(texture), enlarged(texture)
    monkeypatch.setattr(photo_sampling, "STRIP", 4096)
    own.onto(whole)
    monkeypatch.setattr(photo_sampling, "STRIP", 128)
    own.onto(cut)
    assert np.abs(whole.astype(int) - cut).max() <= 65535 / 2000


@pytest.mark.parametrize("size", [(1203, 802), (1536, 1024)])
def test_any_size_can_be_asked_for(scene: tuple[Photo, Texture, OwnDetail], size: tuple[int, int]) -> None:
    _, texture, own = scene
    codes = enlarged(texture, size)
    own.onto(codes)
    right, where = truth(size), seen_by(own, size)
    assert np.abs(codes / 65535 - right)[where].mean() < 0.02


def degraded(photo: Photo, blur: float = 0.0, noise: float = 0.0, factor: int = 1) -> Photo:
    image: np.ndarray = photo.pixels.astype(np.float32)
    if factor > 1:
        small = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
        image = cv2.resize(small, image.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    image = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    image = image + np.random.default_rng(0).normal(0, noise, image.shape)
    return Photo(np.rint(np.clip(image, 0, 255)).astype(np.uint8))


def told_of(photo: Photo) -> tuple[Detail, float]:
    """What is said of a photo, and the error of the map on seen skin."""
    fit = fitted(HEAD, turned(0, 1000))
    texture = make_texture(photo, HEAD, fit, CHART, bare(HEAD, turned(0, 1000)))
    own, codes = OwnDetail.of(photo, HEAD, fit, texture), enlarged(texture)
    told = own.onto(codes)
    return told, float(np.abs(codes / 65535 - truth())[seen_by(own)].mean())


@pytest.mark.parametrize("worse", [{"blur": 6.0}, {"factor": 8}, {"noise": 40.0}])
def test_a_worse_photo_tells_less_and_does_no_harm(
    scene: tuple[Photo, Texture, OwnDetail], worse: dict[str, float]
) -> None:
    photo, texture, own = scene
    good = own.onto(enlarged(texture))
    bad, error = told_of(degraded(photo, **worse))  # type: ignore[arg-type]
    assert bad.octaves[1].share < 0.6 * good.octaves[1].share
    assert error < 0.09


def test_a_photo_that_shows_no_head_changes_nothing() -> None:
    camera = turned(0)
    away = type(camera)(400, 400, camera.focal_px, np.array([9000.0, 200.0]), camera.rotation, camera.translation)
    photo, fit = Photo(np.full((400, 400, 3), 90, np.uint8)), fitted(HEAD, away)
    texture = make_texture(photo, HEAD, fit, CHART)
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
    coarse = make_texture(small, HEAD, fit, CHART)
    assert OwnDetail.of(small, HEAD, fit, coarse).texture_size() == (576, 384)


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


def test_a_photo_with_much_around_the_head_is_read_alike_and_is_not_halved_as_a_whole(
    scene: tuple[Photo, Texture, OwnDetail],
) -> None:
    photo, _, own = scene
    wide = replace(photo, pixels=np.pad(photo.pixels, ((2048, 512), (1024, 3072), (0, 0)), "edge"))
    moved = replace(own.places, pixel=own.places.pixel + np.array([1024, 2048], np.float32))
    size = (288, 192)  # three levels
    plain_reader, wide_reader = Reader.of(photo, own.places, size), Reader.of(wide, moved, size)
    assert len(wide_reader.levels) == len(plain_reader.levels) >= 3
    assert wide_reader.levels[0].size < 2 * photo.pixels.size
    inside = seen_by(own, size)
    different = np.abs(plain_reader.rows(0, size[1]) - wide_reader.rows(0, size[1]))[inside]
    assert float(different.max()) < 0.01  # positions of some thousand pixels are rounded
    assert float(different.mean()) < 1e-4
