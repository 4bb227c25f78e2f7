"""A walk over the chunks of a WebP file (RFC 9649)."""

from __future__ import annotations

from service.errors import AnimatedImage, CorruptImage, TooComplex
from service.photo.container import MAX_ICC_BYTES, Codec, Container

MAX_CHUNKS = 1024

_ALPHA, _ANIMATION = 0x10, 0x02


def walk_webp(data: bytes) -> Container:
    """Take a WebP file apart.

    Args:
        data: the file, beginning with its RIFF header.

    Returns:
        The container; ``payload`` holds the bitstream and its alpha plane.

    Raises:
        CorruptImage: cut off, chunks do not fit together, or no bitstream.
        AnimatedImage: the file has an animation, even one of a single frame.
        TooComplex: more chunks than a photo has.
    """
    chunks = _chunks(data)
    first = chunks[0][0] if chunks else b""
    found = dict(reversed(chunks))
    if first not in (b"VP8 ", b"VP8L", b"VP8X"):
        raise CorruptImage("the WebP file does not begin with an image header")
    if b"ANMF" in found or (first == b"VP8X" and found[first][:1] and found[first][0] & _ANIMATION):
        frames = sum(name == b"ANMF" for name, _ in chunks)
        raise AnimatedImage(
            f"the WebP file is an animation of {frames} frames; a still image is accepted", frames=frames
        )
    bitstream = next((name for name in (b"VP8 ", b"VP8L") if name in found), None)
    if bitstream is None:
        raise CorruptImage("the WebP file has no bitstream")
    size = _bitstream_size(bitstream, found[bitstream])
    kept: list[tuple[bytes, bytes]] = [(bitstream, found[bitstream])]
    if first == b"VP8X":
        header = found[first]
        if len(header) != 10 or size != _canvas(header):
            raise CorruptImage("the canvas and the bitstream of the WebP file differ in size")
        kept.insert(0, (first, bytes((header[0] & _ALPHA,)) + header[1:]))
        if bitstream == b"VP8 " and b"ALPH" in found:
            kept.insert(1, (b"ALPH", found[b"ALPH"]))
    icc = found.get(b"ICCP", b"")
    exif = found.get(b"EXIF", b"").removeprefix(b"Exif\0\0")
    large = len(icc) > MAX_ICC_BYTES
    warnings = ("icc-ignored",) if large else ()
    return Container(Codec.WEBP, size, _riff(kept), exif, b"" if large else icc, warnings=warnings)


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    end = 8 + int.from_bytes(data[4:8], "little")
    if end > len(data):
        raise CorruptImage(f"the WebP file is cut off: it states {end} bytes and has {len(data)}")
    chunks: list[tuple[bytes, bytes]] = []
    position = 12
    while position < end:
        if len(chunks) == MAX_CHUNKS:
            raise TooComplex(f"the WebP file has more than {MAX_CHUNKS} chunks")
        size = int.from_bytes(data[position + 4 : position + 8], "little")
        if position + 8 + size > end:
            raise CorruptImage(f"the WebP file is cut off or damaged near byte {position}", position=position)
        chunks.append((data[position : position + 4], data[position + 8 : position + 8 + size]))
        position += 8 + size + size % 2
    return chunks


def _bitstream_size(name: bytes, body: bytes) -> tuple[int, int]:
    if name == b"VP8 " and len(body) >= 10 and body[3:6] == b"\x9d\x01\x2a":
        return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF
    if name == b"VP8L" and len(body) >= 5 and body[0] == 0x2F:
        bits = int.from_bytes(body[1:5], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    raise CorruptImage("the header of the WebP bitstream is damaged")


def _canvas(header: bytes) -> tuple[int, int]:
    return int.from_bytes(header[4:7], "little") + 1, int.from_bytes(header[7:10], "little") + 1


def _riff(chunks: list[tuple[bytes, bytes]]) -> bytes:
    body = b"WEBP" + b"".join(
        name + len(data).to_bytes(4, "little") + data + b"\0" * (len(data) % 2) for name, data in chunks
    )
    return b"RIFF" + len(body).to_bytes(4, "little") + body
