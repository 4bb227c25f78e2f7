"""PNG and JPEG bytes, and the coding of normals."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from PIL import Image

from service.archive.images import decode_normals8, encode_jpeg, encode_normals8, encode_png
from service.errors import NumericFault

RAMP = np.arange(16 * 24 * 3, dtype=np.uint64).reshape(16, 24, 3).astype(np.uint8)


def chunks(data: bytes) -> list[bytes]:
    names, at = [], 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        names.append(data[at + 4 : at + 8])
        at += 12 + length
    return names


def read(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        image.load()
        return np.asarray(image)


@pytest.mark.parametrize("srgb", [True, False])
def test_another_reader_gets_the_same_pixels(srgb: bool) -> None:
    """Pillow checks the checksums of all chunks, and would see red and blue change places."""
    np.testing.assert_array_equal(read(encode_png(RAMP, srgb=srgb)), RAMP)
    np.testing.assert_array_equal(read(encode_png(RAMP[..., 0], srgb=srgb)), RAMP[..., 0])


def test_colours_say_that_they_are_srgb_and_data_says_nothing() -> None:
    assert chunks(encode_png(RAMP, srgb=True))[:2] == [b"IHDR", b"sRGB"]
    assert set(chunks(encode_png(RAMP, srgb=False))) == {b"IHDR", b"IDAT", b"IEND"}


def test_jpeg_keeps_red_red_and_holds_no_metadata() -> None:
    flat = np.full((16, 16, 3), (200, 40, 90), np.uint8)
    data = encode_jpeg(flat)
    assert np.abs(read(data).astype(int) - flat).max() <= 3
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
