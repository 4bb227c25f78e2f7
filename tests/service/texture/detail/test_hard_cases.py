"""Photos that hold less than their pixels promise: the map is never worse than without them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.arrays import Float32
from service.geometry.camera import Camera
from service.photo.photo import Photo
from service.texture.photo_detail import OwnDetail
from service.texture.photo_sampling import Reader
from service.texture.texture import make_texture
from service.texture.texture_maps import Texture
from tests.service.texture.detail.test_own import CHART, HEAD, SIZE, enlarged, seen_by, spots, truth
from tests.service.texture.scenes import SKIN, bare, fitted, photograph, plain, turned

SHARP, FIT = photograph(HEAD, turned(0, 1000), spots), fitted(HEAD, turned(0, 1000))
RANDOM = np.random.default_rng(7)

Damage = Callable[[Float32], Float32]


def damaged(how: Damage) -> Photo:
    return Photo(np.rint(np.clip(how(SHARP.pixels.astype(np.float32)), 0, 255)).astype(np.uint8))


def upscaled(image: Float32) -> Float32:
    small = cv2.resize(image, None, fx=1 / 5, fy=1 / 5, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, image.shape[1::-1], interpolation=cv2.INTER_CUBIC))


def noise(shape: tuple[int, ...]) -> Float32:
    """Of luma and of colour, as a sensor's at ISO 12800."""
    random = np.random.default_rng(7)
    return np.asarray(random.normal(0, 14, shape[:2])[..., None] + random.normal(0, 10, shape), np.float32)


def iso_12800(image: Float32) -> Float32:
    return np.asarray(image + noise(image.shape), np.float32)


def blotchy(image: Float32) -> Float32:
    """The same after a camera's denoising."""
    return np.asarray(image + cv2.GaussianBlur(noise(image.shape), (0, 0), 0.7), np.float32)


def moire(image: Float32) -> Float32:
    """The beat of a screen's pixels with the sensor's."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.asarray(image + 5 * np.cos(2 * np.pi * (x + 0.3 * y) / 2.3)[..., None], np.float32)


def halos(image: Float32) -> Float32:
    """Sharpened by an unsharp mask."""
    return np.asarray(image + 1.2 * (image - cv2.GaussianBlur(image, (0, 0), 1.5)), np.float32)


def blurred(image: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 6))


def own_of(photo: Photo) -> tuple[Texture, OwnDetail]:
    texture = make_texture(photo, HEAD, FIT, CHART, bare(HEAD, turned(0, 1000)))
    return texture, OwnDetail.of(photo, HEAD, FIT, texture)


@pytest.mark.parametrize("how", [upscaled, iso_12800, moire, blurred])
def test_the_map_is_not_worse_for_it(how: Damage) -> None:
    texture, own = own_of(damaged(how))
    before, after = enlarged(texture), enlarged(texture)
    own.onto(after)
    where, right = seen_by(own), truth()
    errors = [float(np.abs(codes / 65535 - right)[where].mean()) for codes in (before, after)]
    assert errors[1] < 1.02 * errors[0], how.__name__


def test_blotchy_noise_counts_as_detail_in_part() -> None:
    """What is measured is noise that differs from pixel to pixel; a third more error is what the rest may cost."""
    texture, own = own_of(damaged(blotchy))
    before, after = enlarged(texture), enlarged(texture)
    own.onto(after)
    where, right = seen_by(own), truth()
    errors = [float(np.abs(codes / 65535 - right)[where].mean()) for codes in (before, after)]
    assert errors[1] < 1.33 * errors[0]


def test_halos_of_sharpening_are_no_stronger_than_in_the_photo() -> None:
    texture, own = own_of(damaged(halos))
    after = enlarged(texture)
    own.onto(after)
    where, right = seen_by(own), truth()
    photo = Reader.of(own.photo, own.places, SIZE).rows(0, SIZE[1])
    assert np.abs(after / 65535 - right)[where].mean() < 1.1 * np.abs(photo - right)[where].mean()


@pytest.mark.parametrize("how", [upscaled, blurred])
def test_the_texture_is_as_large_as_what_the_photo_truly_holds(how: Damage) -> None:
    _, sharp = own_of(SHARP)
    _, worse = own_of(damaged(how))
    assert worse.texture_size()[0] <= sharp.texture_size()[0] / 2


def test_a_small_face_in_a_photo_of_24_megapixels() -> None:
    side = 170
    face = photograph(HEAD, turned(0, side), spots).pixels
    pixels = np.full((4000, 6000, 3), (25, 153, 51), np.uint8)
    pixels[1000 : 1000 + side, 2000 : 2000 + side] = face
    camera = turned(0, side)
    middle = camera.principal_point + np.array([2000.0, 1000.0])
    far = Camera(6000, 4000, camera.focal_px, middle, camera.rotation, camera.translation)
    photo, fit = Photo(pixels), fitted(HEAD, far)
    texture = make_texture(photo, HEAD, fit, CHART)
    own, before, after = OwnDetail.of(photo, HEAD, fit, texture), enlarged(texture), enlarged(texture)
    told = own.onto(after)
    assert own.texture_size() == (576, 384)
    assert told.octaves[0].share < 0.01
    assert np.abs(before.astype(int) - after).mean() < 0.02 * 65535


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


def test_clipped_light_takes_no_grain_from_the_map() -> None:
    photo = photograph(HEAD, turned(0, 1000), plain(SKIN))
    half = photo.pixels.copy()
    half[:, :500] = 255
    texture = make_texture(photo, HEAD, FIT, CHART, bare(HEAD, turned(0, 1000)))
    grain = RANDOM.normal(0, 1500, (*SIZE[::-1], 1))
    before = np.clip(enlarged(texture) + grain, 0, 65535).astype(np.uint16)
    after, lit = before.copy(), before.copy()
    own = OwnDetail.of(photo, HEAD, FIT, texture)
    replace(own, photo=Photo(half)).onto(after)
    own.onto(lit)

    def fine(codes: np.ndarray) -> np.ndarray:
        grey = codes[..., 1].astype(np.float32)
        return np.asarray(grey - cv2.GaussianBlur(grey, (0, 0), 3))

    x = cv2.resize(np.ascontiguousarray(own.places.pixel[..., 0]), SIZE)
    lost = seen_by(own) & (x < 470)
    assert lost.sum() > 1000
    assert fine(after)[lost].std() == pytest.approx(fine(before)[lost].std(), rel=0.05)
    assert fine(lit)[lost].std() < 0.7 * fine(before)[lost].std()  # flat skin that is seen is flat in the map
