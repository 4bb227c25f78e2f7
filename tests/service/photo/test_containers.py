"""Containers: what is sound is measured without a decoder, what is not is refused, by the walk or behind it."""

from __future__ import annotations

import struct
import time

import pytest

from service.errors import CorruptImage, TooComplex, UnsupportedFormat
from service.photo.container import MAX_CHUNKS, MAX_SEGMENTS, open_container
from service.photo.gate import read_photo
from service.photo.limits import Limits
from tests.service.photo import badimages as bad

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


@pytest.mark.parametrize("frame", [b"\x0c\0\x50\0\x60\1\1\x11\0", b"\x08\0\x50\0\x60\1\1\x11\0"])
def test_jpeg_of_12_bits_or_lossless(frame: bytes) -> None:
    with pytest.raises(UnsupportedFormat, match="8 bits are accepted"):
        read_photo(bad.insert(JPEG, bad.segment(0xC3 if frame[0] == 8 else 0xC1, frame)))


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


def test_fill_bytes_and_padding_between_segments_are_allowed() -> None:
    padded = bad.insert(JPEG, b"\xff\xff\xff\xff" + bad.segment(0xFE, b"x"), b"\0\0")
    assert (read_photo(padded).pixels == read_photo(JPEG).pixels).all()


def test_png_with_a_damaged_profile_is_read_without_it() -> None:
    body = bad.chunk(b"iCCP", b"p\0\0" + bad.zeros_packed(1_000_000))
    for broken in (body[:-1] + bytes((body[-1] ^ 1,)), bad.chunk(b"iCCP", b"p\0\0garbage")):
        assert read_photo(PNG[:33] + broken + PNG[33:]).warnings == ("icc-ignored",)
