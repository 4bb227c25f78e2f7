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
)
from service.errors import NumericFault

RAMP = np.arange(16 * 24 * 3, dtype=np.uint64).reshape(16, 24, 3).astype(np.uint8)


def chunks(data: bytes) -> list[bytes]:
    names, at = [], 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        names.append(data[at + 4 : at + 8])
        at += 12 + length
    return names


def test_colours_say_that_they_are_srgb_and_data_says_nothing() -> None:
    assert chunks(encode_png(RAMP, srgb=True))[:2] == [b"IHDR", b"sRGB"]
    assert set(chunks(encode_png(RAMP, srgb=False))) == {b"IHDR", b"IDAT", b"IEND"}


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


def test_an_image_that_the_encoder_refuses_is_a_fault_and_no_empty_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cv2.imencode", lambda *_: (False, np.zeros(0, np.uint8)))
    image = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(NumericFault, match="png encoder refused"):
        encode_png(image, srgb=True)
    with pytest.raises(NumericFault, match="jpg encoder refused"):
        encode_jpeg(image)
