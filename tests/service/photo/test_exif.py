"""EXIF gives orientation and focal length, or nothing; it never raises and never takes long."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.photo.exif import ExifFacts, read_exif
from tests.service.photo import badimages as bad


@pytest.mark.parametrize("order", [">", "<"])
def test_both_byte_orders(order: str) -> None:
    assert read_exif(bad.exif(order, 6, 28, (4000, 3000)), (4000, 3000)) == ExifFacts(6, 28.0, False)


@pytest.mark.parametrize(
    ("stated", "believed"), [(0, None), (7, None), (8, 8.0), (1200, 1200.0), (1201, None), (65_535, None)]
)
def test_focal_length_must_be_one_of_a_lens(stated: int, believed: float | None) -> None:
    assert read_exif(bad.exif(focal=stated), (100, 100)).focal_35mm == believed


def test_focal_length_of_a_cropped_photo_is_not_used() -> None:
    whole = bad.exif(focal=50, sides=(4000, 3000))
    assert read_exif(whole, (800, 600)).focal_35mm == 50
    assert read_exif(whole, (600, 800)).focal_35mm == 50, "some programs turn the pixels and leave the tags"
    assert read_exif(whole, (600, 600)) == ExifFacts(1, None, cropped=True)
    assert read_exif(bad.exif(focal=50, sides=(0, 0)), (600, 600)).focal_35mm == 50


def test_directory_that_points_at_itself() -> None:
    looping = bytearray(bad.exif(focal=35))
    looping[-22 - 4 + 4 : -22 - 4 + 8] = looping[-22 - 4 + 4 : -22 - 4 + 8]
    at = looping.index(b"\x87\x69") + 8
    looping[at : at + 4] = (8).to_bytes(4, "big")
    assert read_exif(bytes(looping), (100, 100)) == ExifFacts()


def test_huge_directory_takes_no_time() -> None:
    start = time.process_time()
    read_exif(b"MM\0*\0\0\0\x08\xff\xff" + bytes(2_000_000), (100, 100))
    assert time.process_time() - start < 0.1


@given(st.binary(max_size=200))
def test_any_bytes_give_a_valid_answer(noise: bytes) -> None:
    for head in (b"", b"II*\0", b"MM\0*", bad.exif(focal=35)[:12]):
        facts = read_exif(head + noise, (100, 100))
        assert 1 <= facts.orientation <= 8
        assert facts.focal_35mm is None or 8 <= facts.focal_35mm <= 1200


@given(st.integers(0, 10_000), st.integers(0, 255))
def test_any_changed_byte_gives_a_valid_answer(position: int, value: int) -> None:
    tiff = bytearray(bad.exif("<", 8, 35, (4000, 3000)))
    tiff[position % len(tiff)] = value
    assert 1 <= read_exif(bytes(tiff), (100, 100)).orientation <= 8
