"""Which format bytes are, by their first bytes only; names and content types are never looked at."""

from __future__ import annotations

from service.errors import UnsupportedFormat
from service.photo.container import Codec

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
    looks_like = _name(data, brand)
    raise UnsupportedFormat(f"the file is {looks_like}; JPEG, PNG, WebP or HEIC is accepted", looks_like=looks_like)


def is_heic_sequence(data: bytes) -> bool:
    """Whether a HEIC file says of itself that it is moving pictures."""
    return data[8:12] in _HEIC_SEQUENCE_BRANDS


def _name(data: bytes, brand: bytes) -> str:
    if brand in (b"avif", b"avis"):
        return "an AVIF image"
    if brand:
        return "a video or another ISO media file"
    start = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    for magic, name in _OTHERS:
        if data.startswith(magic) or (magic.startswith(b"<") and start.lower().startswith(magic)):
            return name
    return "of no image format that is known"
