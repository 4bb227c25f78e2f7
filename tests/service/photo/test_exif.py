"""EXIF gives orientation and focal length, or nothing; it never raises and never takes long."""

from __future__ import annotations

import struct
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.photo.conversions import MAX_EXIF_BYTES, ExifFacts, read_exif
from tests.service.photo import badimages as bad


@pytest.mark.parametrize("order", [">", "<"])
def test_both_byte_orders(order: str) -> None:
    assert read_exif(bad.exif(order, 6, 28, (4000, 3000))) == ExifFacts(6, 28.0, (4000, 3000))


@pytest.mark.parametrize(
    ("stated", "believed"), [(0, None), (7, None), (8, 8.0), (1200, 1200.0), (1201, None), (65_535, None)]
)
def test_focal_length_must_be_one_of_a_lens(stated: int, believed: float | None) -> None:
    assert read_exif(bad.exif(focal=stated)).focal_35mm == believed


def test_focal_length_of_a_cropped_photo_is_not_used() -> None:
    whole = read_exif(bad.exif(focal=50, sides=(4000, 3000)))
    assert not whole.cropped((800, 600))
    assert not whole.cropped((600, 800)), "some programs turn the pixels and leave the tags"
    assert whole.cropped((600, 600))
    assert not read_exif(bad.exif(focal=50, sides=(0, 0))).cropped((600, 600))
    assert not read_exif(bad.exif(focal=50)).cropped((600, 600))


def test_directory_that_points_at_itself() -> None:
    looping = bytearray(bad.exif(focal=35))
    looping[-22 - 4 + 4 : -22 - 4 + 8] = looping[-22 - 4 + 4 : -22 - 4 + 8]
    at = looping.index(b"\x87\x69") + 8
    looping[at : at + 4] = (8).to_bytes(4, "big")
    assert read_exif(bytes(looping)) == ExifFacts()


def greedy(tags: int, length: int) -> bytes:
    """A directory in which each of many tags claims the whole file as its value."""
    entries = b"".join(struct.pack(">HHII", tag, 7, length, 0) for tag in range(1, tags + 1))
    return (b"MM\0*\0\0\0\x08" + struct.pack(">H", tags) + entries).ljust(length, b"\0")


@pytest.mark.parametrize("hostile", [
    b"MM\0*\0\0\0\x08\xff\xff" + bytes(MAX_EXIF_BYTES),
    greedy(5_000, MAX_EXIF_BYTES),
    b"MM\0+\0\x08\0\0" + (16).to_bytes(8, "big") + b"\xff" * MAX_EXIF_BYTES,
])  # fmt: skip
def test_hostile_directories_take_little_time_and_memory(hostile: bytes) -> None:
    """As much as the decoding process is handed; it would be stopped after seconds, but then the photo is refused."""
    start = time.process_time()
    tracemalloc.start()
    try:
        assert read_exif(hostile[:MAX_EXIF_BYTES]).focal_35mm is None
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 400 * MAX_EXIF_BYTES
    assert time.process_time() - start < 2


@given(st.binary(max_size=200))
def test_any_bytes_give_a_valid_answer(noise: bytes) -> None:
    for head in (b"", b"II*\0", b"MM\0*", bad.exif(focal=35)[:12]):
        facts = read_exif(head + noise)
        assert 1 <= facts.orientation <= 8
        assert facts.focal_35mm is None or 8 <= facts.focal_35mm <= 1200


@given(st.integers(0, 10_000), st.integers(0, 255))
def test_any_changed_byte_gives_a_valid_answer(position: int, value: int) -> None:
    tiff = bytearray(bad.exif("<", 8, 35, (4000, 3000)))
    tiff[position % len(tiff)] = value
    assert 1 <= read_exif(bytes(tiff)).orientation <= 8
