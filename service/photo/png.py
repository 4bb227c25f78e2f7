"""A walk over the chunks of a PNG file (PNG specification, third edition, sections 5 and 11)."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

from service.errors import AnimatedImage, CorruptImage, TooComplex
from service.photo.container import MAX_ICC_BYTES, Codec, Container

MAX_CHUNKS = 65_536
MAX_TEXT_BYTES = 8 * 1024**2
"""Unpacked text of one file; more is an attack on whoever unpacks it."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"IDAT")
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}


class BombError(ValueError):
    """Deflated data unpacks to more than its bound."""


def inflate(data: bytes, bound: int) -> bytes:
    """Unpack a zlib stream, never past ``bound`` bytes.

    Raises:
        BombError: there would be more than ``bound`` bytes.
        zlib.error: the stream is damaged or cut off.
    """
    unpacker = zlib.decompressobj()
    out = unpacker.decompress(data, bound + 1)
    if len(out) > bound:
        raise BombError
    if not unpacker.eof:
        raise zlib.error("incomplete stream")
    return out


class _Walk:
    """What has been collected on the way through one file."""

    def __init__(self) -> None:
        self.header: tuple[int, int] | None = None
        self.kept: list[bytes] = [_SIGNATURE]
        self.exif = b""
        self.icc = b""
        self.gamma = 0.0
        self.srgb = False
        self.text_bytes = 0
        self.pixels = False
        self.warnings: list[str] = []

    def take(self, kind: bytes, body: bytes) -> None:
        if kind == b"IHDR":
            self.take_header(body)
        elif self.header is None:
            raise CorruptImage("the PNG file does not begin with its header chunk")
        elif kind == b"IDAT":
            self.pixels = True
        elif kind == b"acTL":
            frames = int.from_bytes(body[:4], "big")
            if frames != 1:
                raise AnimatedImage(f"the PNG file is animated, with {frames} frames; one is accepted", frames=frames)
        elif kind in (b"zTXt", b"iTXt"):
            self.take_text(kind, body)
        elif kind == b"iCCP":
            self.take_profile(body)
        elif kind == b"eXIf":
            self.exif = self.exif or body.removeprefix(b"Exif\0\0")
        elif kind == b"sRGB":
            self.srgb = True
        elif kind == b"gAMA" and len(body) == 4:
            self.gamma = int.from_bytes(body, "big") / 100_000

    def take_header(self, body: bytes) -> None:
        if self.header is not None or len(body) != 13:
            raise CorruptImage("the PNG header chunk is damaged or repeated")
        width, height, depth, kind, packing, filtering, interlace = struct.unpack(">IIBBBBB", body)
        if depth not in _DEPTHS.get(kind, ()) or packing or filtering or interlace > 1:
            raise CorruptImage(f"the PNG header states {depth} bits of colour type {kind}, which does not exist")
        self.header = width, height

    def take_text(self, kind: bytes, body: bytes) -> None:
        rest = body.partition(b"\0")[2]
        if kind == b"zTXt":
            packed = rest[1:]
        elif rest[:1] == b"\1":
            packed = rest[2:].partition(b"\0")[2].partition(b"\0")[2]
        else:
            return
        try:
            self.text_bytes += len(inflate(packed, MAX_TEXT_BYTES - self.text_bytes))
        except BombError:
            raise CorruptImage(f"a text chunk of the PNG file unpacks to more than {MAX_TEXT_BYTES} bytes") from None
        except zlib.error:
            return

    def take_profile(self, body: bytes) -> None:
        try:
            self.icc = inflate(body.partition(b"\0")[2][1:], MAX_ICC_BYTES)
        except BombError:
            raise CorruptImage(
                f"the colour profile of the PNG file unpacks to more than {MAX_ICC_BYTES} bytes"
            ) from None
        except zlib.error:
            self.warnings.append("icc-ignored")


def walk_png(data: bytes) -> Container:
    """Take a PNG file apart.

    Args:
        data: the file, beginning with the PNG signature.

    Returns:
        The container; ``payload`` holds header, palette, transparency and image data.

    Raises:
        CorruptImage: cut off, a checksum of a critical chunk is wrong, chunks are missing, or a text or profile chunk
            unpacks to far more than it should.
        AnimatedImage: an APNG with more than one frame.
        TooComplex: more chunks than a photo has.
    """
    walk = _Walk()
    for kind, chunk, sound in _chunks(data):
        critical = not kind[0] & 0x20
        if critical and not sound:
            raise CorruptImage(f"the checksum of a {kind.decode('latin-1')!r} chunk of the PNG file is wrong")
        if sound:
            walk.take(kind, chunk[8:-4])
        elif kind == b"iCCP":
            walk.warnings.append("icc-ignored")
        if sound and kind in _KEPT:
            walk.kept.append(chunk)
        if kind == b"IEND":
            break
    if walk.header is None or not walk.pixels:
        raise CorruptImage("the PNG file has no image data")
    walk.kept.append(b"\0\0\0\0IEND\xaeB`\x82")
    gamma = 0.0 if walk.icc or walk.srgb else _plausible(walk.gamma)
    return Container(Codec.PNG, walk.header, b"".join(walk.kept), walk.exif, walk.icc, gamma, tuple(walk.warnings))


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes, bool]]:
    """Yield (type, whole chunk, checksum is right) until the end chunk."""
    position = len(_SIGNATURE)
    for _ in range(MAX_CHUNKS):
        if position + 12 > len(data):
            break
        end = position + 12 + int.from_bytes(data[position : position + 4], "big")
        chunk = data[position:end]
        kind = chunk[4:8]
        if end > len(data) or not kind.isalpha():
            break
        yield kind, chunk, zlib.crc32(chunk[4:-4]) == int.from_bytes(chunk[-4:], "big")
        if kind == b"IEND":
            return
        position = end
    else:
        raise TooComplex(f"the PNG file has more than {MAX_CHUNKS} chunks")
    raise CorruptImage(f"the PNG file is cut off or damaged near byte {position}", position=position)


def _plausible(gamma: float) -> float:
    """The stated exponent where it differs visibly from that of sRGB, which writers state as 1/2.2; else 0."""
    if not 0.1 <= gamma <= 10 or math.isclose(gamma, 1 / 2.2, rel_tol=0.05):
        return 0.0
    return gamma
