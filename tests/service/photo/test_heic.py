"""HEIC is read where its decoder is installed."""

from __future__ import annotations

import importlib.util
import io

import numpy as np
import pytest
from PIL import Image

from service.errors import AnimatedImage, CorruptImage, TooManyPixels, UnreadableInput, UnsupportedFormat
from service.photo.gate import read_photo
from service.photo.limits import Limits
from tests.service.photo import badimages as bad

HEADER_ONLY = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100)


def heic(image: bad.Pixels, **options: object) -> bytes:
    pillow_heif = pytest.importorskip("pillow_heif")
    buffer = io.BytesIO()
    pillow_heif.from_pillow(Image.fromarray(image)).save(buffer, quality=95, **options)
    return buffer.getvalue()


def test_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pillow_heif" else find(name))
    with pytest.raises(UnsupportedFormat, match="install the extra 'heic'") as caught:
        read_photo(HEADER_ONLY)
    assert caught.value.extra == {"extra": "heic"}


def test_read() -> None:
    picture = bad.picture(128, 96)
    photo = read_photo(heic(picture, exif=bad.exif(focal=26)))
    assert photo.size == (128, 96)
    assert np.abs(photo.pixels.astype(int) - picture).mean() < 4
    assert photo.focal_35mm == 26
    assert photo.warnings == ()


def test_limits_hold_before_decoding() -> None:
    with pytest.raises(TooManyPixels, match="256 x 128"):
        read_photo(heic(bad.picture(256, 128)), Limits(max_side=200))


def test_moving_pictures() -> None:
    with pytest.raises(AnimatedImage):
        read_photo(HEADER_ONLY.replace(b"ftypheic", b"ftyphevc"))


def test_cut_and_damaged() -> None:
    data = heic(bad.picture(128, 96))
    for percent in range(1, 100, 12):
        with pytest.raises(UnreadableInput):
            read_photo(data[: len(data) * percent // 100])
    with pytest.raises(CorruptImage):
        read_photo(HEADER_ONLY)
