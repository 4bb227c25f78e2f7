"""What a walk over an image file finds, before any of its pixels are decoded.

The walkers (``jpeg``, ``png``, ``webp``) are plain Python over bounded slices, so they cannot be made to write where
they should not; they run in linear time and allocate no more than the file. They hand on a file with everything
taken out that is not needed for the pixels: the native decoder sees no EXIF, no text, no second image.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from service.errors import UnsupportedFormat

MAX_ICC_BYTES = 4 * 1024**2
"""Largest colour profile that is looked at; printer profiles with tables stay below 3 MB."""

MAX_EXIF_BYTES = 1 << 16
"""As much EXIF as is looked at, and as a JPEG can hold; the directories come first, what is cut off is thumbnails."""


class Codec(IntEnum):
    """The formats that are decoded; an allow-list."""

    JPEG = 1
    PNG = 2
    WEBP = 3
    HEIC = 4


class Container(NamedTuple):
    """One still image, with its metadata taken apart.

    Attributes:
        codec: which decoder to use.
        size: (width, height) in pixels as stored, before any EXIF turn; None where only the decoder can tell.
        payload: a file that holds the pixels of the first image and nothing else.
        exif: TIFF-structured EXIF bytes, or empty.
        icc: colour profile, or empty.
        gamma: encoding exponent of a PNG that states one and has no profile (image = light ** gamma), or 0.
        warnings: stable codes of what was found and left out.
    """

    codec: Codec
    size: tuple[int, int] | None
    payload: bytes
    exif: bytes = b""
    icc: bytes = b""
    gamma: float = 0.0
    warnings: tuple[str, ...] = ()


_HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"mif1"}
_HEIC_SEQUENCE_BRANDS = {b"hevc", b"hevx", b"hevm", b"hevs", b"msf1"}
_OTHERS: tuple[tuple[bytes, str], ...] = (
    (b"GIF8", "a GIF image"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"BM", "a BMP image"),
    (b"II*\x00", "a TIFF image"),
    (b"MM\x00*", "a TIFF image"),
    (b"II+\x00", "a TIFF image"),
    (b"MM\x00+", "a TIFF image"),
    (b"8BPS", "a Photoshop document"),
    (b"%!PS", "a PostScript document"),
    (b"\xc5\xd0\xd3\xc6", "a PostScript document"),
    (b"v/1\x01", "an OpenEXR image"),
    (b"#?", "a Radiance HDR image"),
    (b"SIMPLE  =", "a FITS image"),
    (b"\x00\x00\x01\x00", "a Windows icon"),
    (b"\xff\x4f\xff\x51", "a JPEG 2000 image"),
    (b"\x00\x00\x00\x0cjP  ", "a JPEG 2000 image"),
    (b"\xff\x0a", "a JPEG XL image"),
    (b"\x00\x00\x00\x0cJXL ", "a JPEG XL image"),
    (b"\xff\xd8", "a JPEG stream without its first segment"),
    (b"RIFF", "a RIFF file other than WebP"),
    (b"<svg", "an SVG drawing"),
    (b"<?xml", "an XML document"),
    (b"<", "an HTML or XML document"),
)


def sniff(data: bytes) -> Codec:
    """Name the codec of ``data`` by its magic bytes.

    Args:
        data: the whole file, or at least its first 64 bytes.

    Raises:
        UnsupportedFormat: the bytes do not begin like a format that is accepted; ``looks_like`` says what they are.
    """
    if data.startswith(b"\xff\xd8\xff"):
        return Codec.JPEG
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return Codec.PNG
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return Codec.WEBP
    brand = data[8:12] if data[4:8] == b"ftyp" else b""
    if brand in _HEIC_BRANDS | _HEIC_SEQUENCE_BRANDS:
        return Codec.HEIC
    looks_like = _looks_like(data, brand)
    raise UnsupportedFormat(f"the file is {looks_like}; JPEG, PNG, WebP or HEIC is accepted", looks_like=looks_like)


def is_heic_sequence(data: bytes) -> bool:
    """Whether a HEIC file says of itself that it is moving pictures."""
    return data[8:12] in _HEIC_SEQUENCE_BRANDS


def _looks_like(data: bytes, brand: bytes) -> str:
    if brand in (b"avif", b"avis"):
        return "an AVIF image"
    if brand:
        return "a video or another ISO media file"
    start = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    for magic, name in _OTHERS:
        if data.startswith(magic) or (magic.startswith(b"<") and start.lower().startswith(magic)):
            return name
    return "of no image format that is known"
