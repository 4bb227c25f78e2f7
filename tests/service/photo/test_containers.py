"""The container walks take apart what is sound and refuse what is not, without a decoder."""

from __future__ import annotations

import struct
import time

import pytest

from service.errors import CorruptImage, TooComplex, UnsupportedFormat
from service.photo.container import Codec
from service.photo.jpeg import MAX_SEGMENTS, walk_jpeg
from service.photo.limits import Limits
from service.photo.png import MAX_CHUNKS, BombError, inflate, walk_png
from service.photo.webp import walk_webp
from tests.service.photo import badimages as bad

PICTURE = bad.picture()
JPEG, PNG, WEBP = (bad.save(PICTURE, kind) for kind in ("JPEG", "PNG", "WEBP"))


def test_sizes_agree_with_the_writer() -> None:
    for width, height in ((64, 65), (200, 100), (101, 300)):
        image = bad.picture(width, height)
        assert walk_jpeg(bad.save(image, "JPEG"), Limits()).size == (width, height)
        assert walk_png(bad.save(image, "PNG")).size == (width, height)
        assert walk_webp(bad.save(image, "WEBP")).size == (width, height)
        assert walk_webp(bad.save(image, "WEBP", lossless=True)).size == (width, height)


def test_metadata_is_taken_out_of_every_format() -> None:
    tiff, profile = bad.exif(focal=50), bad.matrix_profile(bad.P3_PRIMARIES, 2.2)
    for kind, walk in (("JPEG", lambda data: walk_jpeg(data, Limits())), ("PNG", walk_png), ("WEBP", walk_webp)):
        found = walk(bad.save(PICTURE, kind, exif=b"Exif\0\0" + tiff, icc_profile=profile))
        assert found.exif == tiff
        assert found.icc == profile
        assert found.codec == Codec[kind]
        again = walk(found.payload)
        assert (again.payload, again.exif, again.icc) == (found.payload, b"", b"")


# JPEG


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"\xff\xd8\xff\xd9", "before its first scan"),
        (JPEG[:2] + bad.segment(0xDA, b"\1\1\0\0\0\0") + b"\xff\xd9", "scan before its frame"),
        (bad.insert(JPEG, *2 * [bad.segment(0xC0, b"\x08\0\x50\0\x60\1\1\x11\0")]), "more than one frame"),
        (bad.insert(JPEG, bad.segment(0xC0, b"\x08\0\x50\0\x60\3\1\x11\0")), "frame header is damaged"),
        (bad.insert(JPEG, b"\xff\x42"), "0x42 is not valid"),
        (bad.insert(JPEG, b"\xff\xd8"), "0xd8 is not valid"),
        (bad.insert(JPEG, b"\xff\xe1\0\1"), "cut off or damaged near byte 4"),
        (bad.insert(JPEG, bad.segment(0xDC, b"\0\x50")), "height after the first scan"),
    ],
)
def test_jpeg_whose_segments_do_not_fit(data: bytes, fault: str) -> None:
    with pytest.raises(CorruptImage, match=fault):
        walk_jpeg(data, Limits())


@pytest.mark.parametrize("frame", [b"\x0c\0\x50\0\x60\1\1\x11\0", b"\x08\0\x50\0\x60\1\1\x11\0"])
def test_jpeg_of_12_bits_or_lossless(frame: bytes) -> None:
    with pytest.raises(UnsupportedFormat, match="8 bits are accepted"):
        walk_jpeg(bad.insert(JPEG, bad.segment(0xC3 if frame[0] == 8 else 0xC1, frame)), Limits())


def test_jpeg_of_endless_segments_is_refused_in_time() -> None:
    data = bad.insert(JPEG, bad.segment(0xFE, b"") * (MAX_SEGMENTS + 1))
    start = time.process_time()
    with pytest.raises(TooComplex, match="segments"):
        walk_jpeg(data, Limits())
    assert time.process_time() - start < 0.5


@pytest.mark.parametrize("filler", [b"\xff", b"\xff\0", b"\xff\xd0", b"\0"])
def test_jpeg_walk_is_linear(filler: bytes) -> None:
    """25 MB of each filler that a marker search could stumble over."""
    data = JPEG[:-2] + filler * (25_000_000 // len(filler))
    start = time.process_time()
    with pytest.raises(CorruptImage, match="cut off"):
        walk_jpeg(data, Limits())
    assert time.process_time() - start < 2


def test_fill_bytes_and_padding_between_segments_are_allowed() -> None:
    found = walk_jpeg(bad.insert(JPEG, b"\xff\xff\xff\xff" + bad.segment(0xFE, b"x"), b"\0\0"), Limits())
    assert found.payload == walk_jpeg(JPEG, Limits()).payload


# PNG


def damaged(kind: bytes) -> bytes:
    at = PNG.index(kind) + 4
    return PNG[:at] + bytes((PNG[at] ^ 1,)) + PNG[at + 1 :]


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (damaged(b"IHDR"), "checksum of a 'IHDR'"),
        (damaged(b"IDAT"), "checksum of a 'IDAT'"),
        (PNG[:8] + PNG[33:], "does not begin with its header"),
        (PNG[:8] + bad.chunk(b"IEND", b""), "does not begin with its header"),
        (PNG[:33] + bad.chunk(b"IEND", b""), "no image data"),
        (PNG[:33] + PNG[8:33] + PNG[33:], "damaged or repeated"),
        (PNG[:8] + bad.chunk(b"IHDR", struct.pack(">IIBBBBB", 96, 80, 7, 2, 0, 0, 0)) + PNG[33:], "7 bits of colour"),
        (PNG[:8] + bad.chunk(b"IHDR", struct.pack(">IIBBBBB", 96, 80, 8, 2, 0, 0, 9)) + PNG[33:], "does not exist"),
        (PNG[:33] + b"\xff\xff\xff\xffIDAT" + PNG[41:], "cut off or damaged near byte 33"),
        (PNG[:33] + b"\0\0\0\0I\0\0\0" + bytes(4) + PNG[33:], "near byte 33"),
    ],
)
def test_png_whose_chunks_do_not_fit(data: bytes, fault: str) -> None:
    with pytest.raises(CorruptImage, match=fault):
        walk_png(data)


def test_png_of_endless_chunks_is_refused_in_time() -> None:
    data = PNG[:33] + bad.chunk(b"tEXt", b"") * (MAX_CHUNKS + 1) + PNG[33:]
    start = time.process_time()
    with pytest.raises(TooComplex, match="chunks"):
        walk_png(data)
    assert time.process_time() - start < 2


def test_png_with_a_damaged_profile_chunk_is_read_without_it() -> None:
    body = bad.chunk(b"iCCP", b"p\0\0" + bad.zeros_packed(1_000_000))
    for broken in (body[:-1] + bytes((body[-1] ^ 1,)), bad.chunk(b"iCCP", b"p\0\0garbage"), bad.chunk(b"iCCP", b"")):
        assert walk_png(PNG[:33] + broken + PNG[33:]).warnings == ("icc-ignored",)


def test_inflate_stops_at_its_bound() -> None:
    packed = bad.zeros_packed(2_000_000)
    assert len(inflate(packed, 2_000_000)) == 2_000_000
    with pytest.raises(BombError):
        inflate(packed, 1_999_999)


# WebP


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (WEBP[:12], "cut off"),
        (b"RIFF\4\0\0\0WEBP", "does not begin with an image header"),
        (b"RIFF\x0c\0\0\0WEBPVP8 \0\0\0\0", "bitstream is damaged"),
        (b"RIFF\x0c\0\0\0WEBPEXIF\0\0\0\0", "does not begin with an image header"),
        (b"RIFF\x16\0\0\0WEBPVP8X\x0a\0\0\0" + bytes(10), "no bitstream"),
        (WEBP[:4] + (len(WEBP) - 9).to_bytes(4, "little") + WEBP[8:-1], "near byte 12"),
    ],
)
def test_webp_whose_chunks_do_not_fit(data: bytes, fault: str) -> None:
    with pytest.raises(CorruptImage, match=fault):
        walk_webp(data)


def test_webp_canvas_of_another_size_than_its_bitstream() -> None:
    data = bytearray(bad.save(PICTURE, "WEBP", exif=bad.exif()))
    assert data[12:16] == b"VP8X"
    data[24] ^= 1
    with pytest.raises(CorruptImage, match="differ in size"):
        walk_webp(bytes(data))
