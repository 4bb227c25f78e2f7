"""Containers and EXIF: what is sound is read, what is not is refused or ignored; damage ends in no other way."""

from __future__ import annotations

import struct
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import CorruptImage, TooComplex
from service.photo.container import (
    AVIF_BRANDS,
    HEIC_BRANDS,
    HEIC_SEQUENCE_BRANDS,
    MAX_CHUNKS,
    MAX_SEGMENTS,
    open_container,
)
from service.photo.decoder import MAX_EXIF_BYTES, ExifFacts, read_exif
from service.photo.gate import read_photo
from service.photo.limits import Limits
from service.photo.video import is_video
from tests.service.photo import badimages as bad
from tests.tools.gate_fuzz import decode_here, decode_in_child, run, seeds

PICTURE = bad.picture()
JPEG, PNG, WEBP = (bad.save(PICTURE, kind) for kind in ("JPEG", "PNG", "WEBP"))
EXTENDED = bad.save(PICTURE, "WEBP", exif=bad.exif())


@pytest.mark.parametrize(
    ("kind", "options"),
    [("JPEG", {}), ("PNG", {}), ("WEBP", {}), ("WEBP", {"lossless": True}), ("WEBP", {"exif": bad.exif()})],
)
@pytest.mark.parametrize("size", [(64, 65), (200, 100), (101, 300)])
def test_sizes_agree_with_the_writer(kind: str, options: dict[str, object], size: tuple[int, int]) -> None:
    assert open_container(bad.save(bad.picture(*size), kind, **options), Limits()).size == size


def test_text_of_a_png_goes_no_further() -> None:
    """Pillow keeps it beside what it tells of the image, under names that the file chooses."""
    text = bad.chunk(b"tEXt", b"transparency\0secret") + bad.chunk(b"zTXt", b"icc_profile\0\0garbage")
    assert open_container(PNG[:33] + text + PNG[33:], Limits()).payload == PNG


def header(*fields: int) -> bytes:
    return bad.chunk(b"IHDR", struct.pack(">IIBBBBB", *fields))


def damaged(kind: bytes) -> bytes:
    at = PNG.index(kind) + 4
    return PNG[:at] + bytes((PNG[at] ^ 1,)) + PNG[at + 1 :]


CORRUPT = {
    "jpeg without a frame": b"\xff\xd8\xff\xd9",
    "scan before the frame": JPEG[:2] + bad.segment(0xDA, b"\1\1\0\0\0\0") + b"\xff\xd9",
    "two frames": bad.insert(JPEG, *2 * [bad.segment(0xC0, b"\x08\0\x50\0\x60\1\1\x11\0")]),
    "frame of too few components": bad.insert(JPEG, bad.segment(0xC0, b"\x08\0\x50\0\x60\3\1\x11\0")),
    "no such marker": bad.insert(JPEG, b"\xff\x42"),
    "start in the middle": bad.insert(JPEG, b"\xff\xd8"),
    "segment shorter than its length": bad.insert(JPEG, b"\xff\xe1\0\1"),
    "checksum of the header": damaged(b"IHDR"),
    "checksum of the pixels": damaged(b"IDAT"),
    "png without a header": PNG[:8] + PNG[33:],
    "png of an end": PNG[:8] + bad.chunk(b"IEND", b""),
    "png without pixels": PNG[:33] + bad.chunk(b"IEND", b""),
    "7 bits": PNG[:8] + header(96, 80, 7, 2, 0, 0, 0) + PNG[33:],
    "unknown filter": PNG[:8] + header(96, 80, 8, 2, 0, 9, 0) + PNG[33:],
    "chunk beyond the end": PNG[:33] + b"\xff\xff\xff\xffIDAT" + PNG[41:],
    "chunk without a name": PNG[:33] + b"\0\0\0\0I\0\0\0" + bytes(4) + PNG[33:],
    "webp cut": WEBP[:12],
    "webp of nothing": b"RIFF\4\0\0\0WEBP",
    "webp of an empty bitstream": b"RIFF\x0c\0\0\0WEBPVP8 \0\0\0\0",
    "webp of metadata": b"RIFF\x0c\0\0\0WEBPEXIF\0\0\0\0",
    "webp of another length": WEBP[:4] + (len(WEBP) - 9).to_bytes(4, "little") + WEBP[8:-1],
    "canvas of another size": EXTENDED[:24] + bytes((EXTENDED[24] ^ 1,)) + EXTENDED[25:],
}


@pytest.mark.parametrize("name", CORRUPT)
def test_parts_that_do_not_fit(name: str) -> None:
    with pytest.raises(CorruptImage):
        read_photo(CORRUPT[name])


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (bad.insert(JPEG, bad.segment(0xFE, b"") * (MAX_SEGMENTS + 1)), "segments"),
        (PNG[:33] + bad.chunk(b"tEXt", b"") * (MAX_CHUNKS + 1) + PNG[33:], "chunks"),
    ],
)
def test_endless_parts_are_refused_in_time(data: bytes, what: str) -> None:
    start = time.process_time()
    with pytest.raises(TooComplex, match=what):
        open_container(data, Limits())
    assert time.process_time() - start < 2


@pytest.mark.parametrize("filler", [b"\xff", b"\xff\0", b"\xff\xd0", b"\0"])
def test_the_walk_over_a_jpeg_is_linear(filler: bytes) -> None:
    """25 MB of each filler that a marker search could stumble over."""
    data = JPEG[:-2] + filler * (25_000_000 // len(filler))
    start = time.process_time()
    with pytest.raises(CorruptImage, match="cut off"):
        open_container(data, Limits())
    assert time.process_time() - start < 2


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


def faults(outcomes: dict[str, int]) -> list[str]:
    return [outcome for outcome in outcomes if outcome.startswith("FAULT")]


def test_damaged_files() -> None:
    outcomes = run(700, 1, decode_here)
    assert not faults(outcomes)
    assert outcomes["photo"] > 20, "damage that never leaves a photo would not reach the decoder's end"
    assert outcomes["refused: corrupt-image"] > 200


def test_damaged_files_through_the_whole_gate() -> None:
    assert not faults(run(26, 2, decode_in_child))


@pytest.mark.slow
def test_ten_thousand_damaged_files() -> None:
    assert not faults(run(10_000, 3, decode_here))


@pytest.mark.slow
def test_a_thousand_damaged_files_through_the_whole_gate() -> None:
    assert not faults(run(1000, 4, decode_in_child))


def test_seeds_are_sound() -> None:
    for data in seeds():
        assert decode_here(data) == "photo"


@pytest.mark.parametrize("brand", sorted(HEIC_BRANDS | HEIC_SEQUENCE_BRANDS | AVIF_BRANDS))
def test_photos_in_the_container_of_videos_are_no_videos(brand: bytes) -> None:
    """A burst or a tiled photo was taken for a video, of which nothing could be read."""
    head = (24).to_bytes(4, "big") + b"ftyp"
    assert not is_video(head + brand + bytes(12))
    assert is_video(head + b"isom" + bytes(12))
