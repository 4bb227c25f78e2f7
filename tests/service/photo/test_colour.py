"""Colours come out right, computed here from the standards; grey and tinted photos are told from coloured ones."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service.photo.gate import read_photo
from service.photo.photo import lacks_colour
from tests.service.photo import badimages as bad

COLOURS = np.array([[200, 120, 90], [128, 128, 128], [60, 90, 160], [230, 200, 180], [20, 30, 15], [255, 255, 255]])


def expected_srgb(
    colours: npt.NDArray[np.int64], xy: Sequence[Sequence[float]], gamma: float | None
) -> npt.NDArray[np.float64]:
    encoded = colours / 255
    if gamma is None:
        linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    else:
        linear = encoded**gamma
    to_srgb = np.linalg.inv(bad.primaries_to_xyz(bad.SRGB_PRIMARIES)) @ bad.primaries_to_xyz(xy)
    light = np.clip(linear @ to_srgb.T, 0, 1)
    return np.asarray(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


@pytest.mark.parametrize(
    ("xy", "gamma"), [(bad.P3_PRIMARIES, None), (bad.ADOBE_PRIMARIES, 563 / 256), (bad.SRGB_PRIMARIES, None)]
)
@pytest.mark.parametrize("alpha", [False, True])
def test_profile_to_srgb(xy: Sequence[Sequence[float]], gamma: float | None, alpha: bool) -> None:
    profile = bad.matrix_profile(xy, bad.SRGB_CURVE if gamma is None else gamma)
    stripes = np.repeat(np.repeat(COLOURS[None], 80, axis=0), 16, axis=1).astype(np.uint8)
    image = Image.fromarray(np.dstack([stripes, np.full(stripes.shape[:2], 255, np.uint8)]) if alpha else stripes)
    expected = expected_srgb(COLOURS, xy, gamma)
    if xy != bad.SRGB_PRIMARIES:
        assert np.abs(expected - COLOURS).max() > 8, "a profile that changes nothing would prove nothing"
    for kind in ("PNG", "WEBP"):
        photo = read_photo(bad.save(image, kind, icc_profile=profile, lossless=True))
        assert np.abs(photo.pixels[40, 8::16] - expected).max() <= 1.5
        assert photo.warnings == ()


def test_profile_in_many_jpeg_segments_and_out_of_order() -> None:
    profile = bad.matrix_profile(bad.P3_PRIMARIES, bad.SRGB_CURVE)
    flat = np.full((80, 96, 3), COLOURS[0], np.uint8)
    data = bad.save(flat, "JPEG", quality=100, subsampling=0)
    halves = [
        bad.segment(0xE2, b"ICC_PROFILE\0" + bytes((i + 1, 2)) + part)
        for i, part in enumerate((profile[:200], profile[200:]))
    ]
    photo = read_photo(bad.insert(data, halves[1], halves[0]))
    assert np.abs(photo.pixels[40, 48] - expected_srgb(COLOURS[:1], bad.P3_PRIMARIES, None)[0]).max() <= 2.5
    assert "icc-ignored" not in photo.warnings


@pytest.mark.parametrize("ycck", [False, True])
@pytest.mark.parametrize("ink", [(0, 0, 0, 0), (30, 110, 140, 20), (200, 40, 10, 60), (0, 0, 0, 255)])
def test_four_inks(ink: tuple[int, int, int, int], ycck: bool) -> None:
    photo = read_photo(bad.cmyk_jpeg(ink, ycck=ycck))
    c, m, y, k = (value / 255 for value in ink)
    expected = 255 * np.array([(1 - c) * (1 - k), (1 - m) * (1 - k), (1 - y) * (1 - k)])
    assert np.abs(photo.pixels.reshape(-1, 3) - expected).max() <= 3


# 16 bits a sample


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize(("colour_type", "channels"), [(0, 1), (2, 3)])
def test_16_bits_are_rounded_not_clipped_and_not_chopped(colour_type: int, channels: int, interlaced: bool) -> None:
    rng = np.random.default_rng(3)
    samples = rng.integers(0, 65_536, (80, 96, channels))
    samples[0] = np.arange(96)[:, None] * 257 + rng.integers(-130, 131, (96, channels))
    samples = samples.clip(0, 65_535)
    photo = read_photo(bad.png(samples, colour_type, 16, interlaced=interlaced))
    expected = np.broadcast_to(np.floor(samples / 257 + 0.5), (80, 96, 3))
    assert np.array_equal(photo.pixels, expected)


PICTURE = bad.picture(400, 300)
GREY = PICTURE.mean(axis=2, keepdims=True)


def as_pixels(values: np.ndarray) -> bad.Pixels:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def walled(size: int, code: int, at: tuple[int, int], patch: bad.Pixels) -> bad.Pixels:
    wall = np.full((size, size, 3), code, np.uint8)
    wall[at[0] : at[0] + patch.shape[0], at[1] : at[1] + patch.shape[1]] = patch
    return wall


def after_jpeg(quality: int) -> bad.Pixels:
    sepia = as_pixels(np.clip(GREY + np.random.default_rng(1).normal(0, 6, GREY.shape), 0, 255) * (1, 0.88, 0.7))
    return np.asarray(Image.open(io.BytesIO(bad.save(sepia, "JPEG", quality=quality))))


SHADOWS = np.array([20, 30, 60])
LACKING = {
    "grey": as_pixels(GREY.repeat(3, axis=2)),
    # Sepia and cyanotype: colours far from grey, but only one for each lightness.
    **{f"print {tint}": as_pixels(GREY * tint) for tint in ((1.0, 0.97, 0.93), (1.0, 0.85, 0.65), (0.75, 0.85, 1.0))},
    "tint that changes with lightness": as_pixels(SHADOWS + GREY / 255 * (np.array([255, 240, 215]) - SHADOWS)),
    "print after jpeg": after_jpeg(90),
    "print after strong jpeg": after_jpeg(50),
    "noise of a sensor": as_pixels(GREY + np.random.default_rng(0).normal(0, 3, PICTURE.shape)),
    # No lightness to fit against: the fit is singular and must still give an answer.
    **{f"flat {value}": np.full((64, 64, 3), value, np.uint8) for value in (0, 128, 255)},
}
COLOURED = {
    "waves": PICTURE,
    # A render of one albedo: its colour follows its lightness as in a sepia print, but the wall's does not.
    "one skin before a grey wall": walled(300, 140, (60, 60), as_pixels(GREY[:180, :180] / 255 * (225, 170, 140))),
    "a small face before a white wall": walled(
        600, 245, (250, 260), bad.picture(70, 80) // 3 + np.array([120, 70, 50], np.uint8)
    ),
}


@pytest.mark.parametrize("name", [*LACKING, *COLOURED])
def test_what_lacks_colour(name: str) -> None:
    assert lacks_colour((LACKING | COLOURED)[name]) == (name in LACKING)
