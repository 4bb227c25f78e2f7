"""PNG, JPEG and EXR bytes and the coding of normals, read back by decoders that share nothing with the writers."""

from __future__ import annotations

import io
import struct

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service.archive.images import (
    STRIP_ROWS,
    Rows,
    decode_normals8,
    encode_jpeg,
    encode_normals8,
    encode_png,
    encode_png_rows,
    exr_bytes,
)
from service.errors import NumericFault
from tests.tools.surfaces import exr

RAMP = np.arange(16 * 24 * 3, dtype=np.uint64).reshape(16, 24, 3).astype(np.uint8)


def chunks(data: bytes) -> list[bytes]:
    names, at = [], 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        names.append(data[at + 4 : at + 8])
        at += 12 + length
    return names


def decoded(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        image.load()
        return np.asarray(image)


@pytest.mark.parametrize("srgb", [True, False])
def test_another_reader_gets_the_same_pixels(srgb: bool) -> None:
    """Pillow checks the checksums of all chunks, and would see red and blue change places."""
    np.testing.assert_array_equal(decoded(encode_png(RAMP, srgb=srgb)), RAMP)
    np.testing.assert_array_equal(decoded(encode_png(RAMP[..., 0], srgb=srgb)), RAMP[..., 0])


def test_colours_say_that_they_are_srgb_and_data_says_nothing() -> None:
    assert chunks(encode_png(RAMP, srgb=True))[:2] == [b"IHDR", b"sRGB"]
    assert set(chunks(encode_png(RAMP, srgb=False))) == {b"IHDR", b"IDAT", b"IEND"}


def test_jpeg_keeps_red_red_and_holds_no_metadata() -> None:
    flat = np.full((16, 16, 3), (200, 40, 90), np.uint8)
    data = encode_jpeg(flat)
    assert np.abs(decoded(data).astype(int) - flat).max() <= 3
    assert b"Exif" not in data and data == encode_jpeg(flat)


def test_a_flat_normal_map_decodes_to_flat() -> None:
    """With n * 0.5 + 0.5 over 255 zero has no code, and integrating a flat map gives a ramp."""
    flat = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (4, 4, 1))
    codes = encode_normals8(flat)
    assert codes[0, 0].tolist() == [128, 128, 255]
    np.testing.assert_array_equal(decode_normals8(codes), flat)


def test_normals_come_back_within_half_a_code() -> None:
    normals = np.random.default_rng(0).normal(size=(50, 60, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    assert np.abs(decode_normals8(encode_normals8(normals)) - normals).max() <= 0.5 / 127 + 1e-6
    extremes = np.array([[[-1.0, 1.0, 0.0]]])
    assert encode_normals8(extremes).ravel().tolist() == [1, 255, 128]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.1])
def test_a_normal_that_is_none_is_named(bad: float) -> None:
    normals = np.zeros((3, 4, 3))
    normals[1, 2, 0] = bad
    with pytest.raises(NumericFault, match="row 1, column 2, channel 0"):
        encode_normals8(normals)


RNG = np.random.default_rng(8)


def noise(shape: tuple[int, ...], bits: int) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
    if bits == 8:
        return RNG.integers(0, 256, shape, np.uint8)
    return RNG.integers(0, 65536, shape, np.uint16)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (STRIP_ROWS, 3), (STRIP_ROWS + 1, 5), (3 * STRIP_ROWS - 1, 40)])
def test_what_goes_in_comes_out(size: tuple[int, int], channels: tuple[int, ...], bits: int) -> None:
    """One row, one column, strips that end with the image and strips that do not."""
    image = noise((*size, *channels), bits)
    data = encode_png_rows(Rows.of(image), srgb=False)
    found = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    if channels:
        found = found[..., [2, 1, 0, 3][: channels[0]]]
    np.testing.assert_array_equal(found, image)
    assert found.dtype == image.dtype
    with Image.open(io.BytesIO(data)) as opened:
        opened.load()  # Pillow checks every chunk's sum
        assert opened.size == size[::-1] and "srgb" not in opened.info


def test_colours_say_that_they_are_srgb() -> None:
    with Image.open(io.BytesIO(encode_png_rows(Rows.of(noise((4, 5, 3), 8)), srgb=True))) as opened:
        assert opened.info["srgb"] == 0


def test_rows_are_asked_for_once_and_in_order() -> None:
    """Maps are computed as they are written; a second look at a strip would compute it twice."""
    image, asked = noise((2 * STRIP_ROWS + 9, 6), 16), []

    def read(first: int, last: int) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        asked.append((first, last))
        return image[first:last]

    assert encode_png_rows(Rows(image.shape, 16, read), srgb=False) == encode_png_rows(Rows.of(image), srgb=False)
    assert asked == [(0, STRIP_ROWS), (STRIP_ROWS, 2 * STRIP_ROWS), (2 * STRIP_ROWS, 2 * STRIP_ROWS + 9)]


@pytest.mark.parametrize(("shape", "bits"), [((4, 4, 2), 8), ((4, 4), 12), ((0, 4), 8), ((4, 0, 3), 16)])
def test_what_png_does_not_have(shape: tuple[int, ...], bits: int) -> None:
    with pytest.raises(ValueError, match="PNG has no"):
        rows = Rows(shape, bits, lambda first, last: np.zeros((last - first, *shape[1:]), np.uint8))
        encode_png_rows(rows, srgb=False)


@pytest.mark.parametrize("shape", [(37, 21), (37, 21, 3), (16, 1, 3), (1, 5)])
def test_it_is_read_back(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(4).uniform(-1, 2, shape).astype(np.float32)
    image.reshape(-1)[: image.size // 2] = 0.25  # a part that compresses
    pytest.importorskip("mitsuba")
    np.testing.assert_array_equal(exr(exr_bytes(image)), image.astype(np.float16))


def test_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2, 2\)"):
        exr_bytes(np.zeros((2, 2, 2), np.float32))
