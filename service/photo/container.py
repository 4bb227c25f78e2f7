"""Which format bytes are, and what their container says before any pixel is decoded: size, scans, and where it ends.

Plain Python over bounded slices, in linear time: names and content types are never looked at, and most bad input is
refused here within a millisecond. What is inside segments and chunks is the decoding process's to judge.
"""

from __future__ import annotations

import importlib.util
import re
import zlib
from typing import NamedTuple

from service.errors import AnimatedImage, CorruptImage, TooComplex, UnsupportedFormat
from service.photo.limits import Limits, check_size
from service.photo.wire import Codec
from service.words import WarningCode

MAX_SEGMENTS = 8192
"""Segments of a JPEG file."""
MAX_CHUNKS = 65_536
"""Chunks of a PNG file."""


class Container(NamedTuple):
    """One still image in its file.

    Attributes:
        codec: which decoder to use.
        size: (width, height) in pixels as stored, before any EXIF turn; None where only the decoder can tell.
        payload: the file up to the end of its first image, with what tells how to show that, and without text.
        warnings: stable codes of what was found and left out.
    """

    codec: Codec
    size: tuple[int, int] | None
    payload: bytes
    warnings: tuple[WarningCode, ...] = ()


_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_KEPT = frozenset((b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND", b"iCCP", b"eXIf", b"sRGB", b"gAMA"))
"""Without text, which may be packed a thousandfold, and which Pillow keeps under names that the file chooses."""
_EOI, _SOS, _DHT, _DAC, _APP1, _COM = 0xD9, 0xDA, 0xC4, 0xCC, 0xE1, 0xFE
_JPEG_KEPT = (b"JFIF\0", b"Adobe", b"ICC_PROFILE\0", b"MPF\0")
"""Application segments that tell how to show the image, or that there are more; and EXIF."""
_FRAMES = frozenset(range(0xC0, 0xD0)) - {_DHT, 0xC8, _DAC}
_LOSSLESS = (0xC3, 0xC7, 0xCB, 0xCF)
# Inside entropy-coded data 0xFF is always followed by a stuffed zero or a restart number (T.81, B.1.1.5).
_MARKER = re.compile(rb"\xff([^\x00\xd0-\xd7\xff])")

HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"mif1"}
HEIC_SEQUENCE_BRANDS = {b"hevc", b"hevx", b"hevm", b"hevs", b"msf1"}
AVIF_BRANDS = {b"avif", b"avis"}
"""Brands of the container of MP4 that are photos; AVIF is told, and refused."""
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
    """Name the codec of a file by its magic bytes, which are in its first 64.

    UnsupportedFormat: it begins like no format that is accepted; ``looks_like`` says what it is.
    """
    if data.startswith(b"\xff\xd8\xff"):
        return Codec.JPEG
    if data.startswith(_PNG_SIGNATURE):
        return Codec.PNG
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return Codec.WebP
    brand = data[8:12] if data[4:8] == b"ftyp" else b""
    if brand in HEIC_BRANDS | HEIC_SEQUENCE_BRANDS:
        return Codec.HEIC
    looks_like = _looks_like(data, brand)
    accepted = ", ".join(readable_formats())
    raise UnsupportedFormat(f"the file is {looks_like}; {accepted} are accepted", looks_like=looks_like)


def readable_formats() -> tuple[str, ...]:
    """Names of the formats that this installation reads; HEIC where its decoder is installed."""
    heic = importlib.util.find_spec("pillow_heif") is not None
    return tuple(codec.name for codec in Codec if codec != Codec.HEIC or heic)


def _looks_like(data: bytes, brand: bytes) -> str:
    if brand in AVIF_BRANDS:
        return "an AVIF image"
    if brand:
        return "a video or another ISO media file"
    start = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    for magic, name in _OTHERS:
        if data.startswith(magic) or (magic.startswith(b"<") and start.lower().startswith(magic)):
            return name
    return "of no image format that is known"


def open_container(data: bytes, limits: Limits) -> Container:
    """Read an image file's format, container and stated size, without decoding; raises as ``gate.read_photo``."""
    codec = sniff(data)
    if codec == Codec.HEIC:
        if data[8:12] in HEIC_SEQUENCE_BRANDS:
            raise AnimatedImage("the HEIC file is a sequence of pictures; a still image is accepted")
        return Container(codec, None, data)
    container = {Codec.JPEG: _open_jpeg, Codec.PNG: _open_png, Codec.WebP: _open_webp}[codec](data, limits)
    if container.size is not None:
        check_size(*container.size, limits)
    return container


def _open_jpeg(data: bytes, limits: Limits) -> Container:
    """Walk over the segments of a JPEG file (ITU-T T.81, annex B) up to the end of its first image."""
    size, scans, position, start, wanted, exif = None, 0, 2, 0, True, False
    kept: list[bytes] = []
    for _ in range(MAX_SEGMENTS):
        found = _MARKER.search(data, position)
        if found is None:
            raise _cut_off("JPEG", len(data))
        if wanted:
            kept.append(data[start : found.start()])
        start, marker, position = found.start(), data[found.start() + 1], found.end()
        if marker == _EOI:
            if size is None or not scans:
                raise CorruptImage("the JPEG file ends before its first scan")
            more = data[position : position + 64].lstrip(b"\0").startswith(b"\xff\xd8\xff")
            whole = b"".join([*kept, data[start:position]])
            return Container(Codec.JPEG, size, whole, ("extra-images-ignored",) if more else ())
        length = int.from_bytes(data[position : position + 2], "big")
        if length < 2 or position + length > len(data):
            raise _cut_off("JPEG", position)
        body = data[position + 2 : position + length]
        wanted = not (0xE0 <= marker <= 0xEF or marker == _COM) or body.startswith(_JPEG_KEPT)
        if marker == _APP1 and body.startswith(b"Exif\0\0"):
            # One segment, 64 kB, as Pillow reads all of it, and entries may each claim the whole.
            wanted, exif = not exif, True
        if marker in _FRAMES:
            if size is not None or length < 8:
                raise CorruptImage("the JPEG frame header is damaged or repeated")
            if data[position + 2] != 8 or marker in _LOSSLESS:
                bits = data[position + 2]
                raise UnsupportedFormat(f"the JPEG file has {bits} bits a sample or is lossless; 8 bits are accepted")
            height, width = (int.from_bytes(data[at : at + 2], "big") for at in (position + 3, position + 5))
            size = width, height
        scans += marker == _SOS
        if scans > limits.max_scans:
            raise TooComplex(
                f"the JPEG file has more than {limits.max_scans} scans; an ordinary photo has 1 to 20",
                limit=limits.max_scans,
            )
        position += length
    raise TooComplex(f"the JPEG file has more than {MAX_SEGMENTS} segments")


def _open_png(data: bytes, limits: Limits) -> Container:
    """Walk over the chunks of a PNG file (PNG specification, third edition, section 5) up to its last."""
    kept, position = [_PNG_SIGNATURE], len(_PNG_SIGNATURE)
    warnings: list[WarningCode] = []
    if data[12:16] != b"IHDR":
        raise CorruptImage("the PNG file does not begin with its header chunk")
    for _ in range(MAX_CHUNKS):
        end = position + 12 + int.from_bytes(data[position : position + 4], "big")
        kind = data[position + 4 : position + 8]
        if end > len(data) or not kind.isalpha():
            raise _cut_off("PNG", position)
        if kind in _PNG_KEPT:
            chunk = data[position:end]
            if zlib.crc32(chunk[4:-4]) == int.from_bytes(chunk[-4:], "big"):
                kept.append(chunk)
            elif kind == b"iCCP":
                warnings.append("icc-ignored")
            elif kind.isupper():
                raise CorruptImage(f"the checksum of a {kind.decode()!r} chunk of the PNG file is wrong")
        frames = int.from_bytes(data[position + 8 : position + 12], "big")
        if kind == b"acTL" and frames != 1:
            raise AnimatedImage(f"the PNG file is animated, with {frames} frames; one is accepted", frames=frames)
        if kind == b"IEND":
            size = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
            return Container(Codec.PNG, size, b"".join(kept), tuple(warnings))
        position = end
    raise TooComplex(f"the PNG file has more than {MAX_CHUNKS} chunks")


def _open_webp(data: bytes, limits: Limits) -> Container:
    """The length and the first chunk of a WebP file (RFC 9649)."""
    if 8 + int.from_bytes(data[4:8], "little") > len(data):
        raise _cut_off("WebP", len(data))
    kind, head = data[12:16], data[20:30]
    if kind == b"VP8X" and len(head) == 10:
        size = int.from_bytes(head[4:7], "little") + 1, int.from_bytes(head[7:10], "little") + 1
    elif kind == b"VP8 " and head[3:6] == b"\x9d\x01\x2a":
        size = int.from_bytes(head[6:8], "little") & 0x3FFF, int.from_bytes(head[8:10], "little") & 0x3FFF
    elif kind == b"VP8L" and head[:1] == b"\x2f":
        bits = int.from_bytes(head[1:5], "little")
        size = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    else:
        raise CorruptImage("the WebP file does not begin with an image header")
    return Container(Codec.WebP, size, data)


def _cut_off(name: str, position: int) -> CorruptImage:
    return CorruptImage(f"the {name} file is cut off or damaged near byte {position}", position=position)
