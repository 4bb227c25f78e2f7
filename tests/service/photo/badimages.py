"""Every kind of image file that the gate must answer for, made in code.

Good ones are made by Pillow's writers, or byte by byte where Pillow cannot write them (16-bit colour, interlaced PNG,
YCCK, EXIF, ICC profiles), so that what the gate reads was not written by the code that reads it.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

Pixels = npt.NDArray[np.uint8]

ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""(x start, y start, x step, y step) of the seven passes."""


def picture(width: int = 96, height: int = 80, seed: int = 1) -> Pixels:
    """A colourful image with no symmetry: smooth waves and a little noise. (H, W, 3) uint8."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / max(width, height)
    waves = [np.sin(x * (3 + c) + y * (5 - 2 * c) + c) * 90 + 128 + 30 * (c - 1) * x for c in range(3)]
    noisy = np.stack(waves, axis=-1) + rng.normal(0, 2, (height, width, 3))
    return np.clip(noisy, 0, 255).astype(np.uint8)


def save(image: Pixels | Image.Image, kind: str, **options: Any) -> bytes:
    """Written by Pillow."""
    buffer = io.BytesIO()
    (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(buffer, kind, **options)
    return buffer.getvalue()


# --- PNG byte by byte ---


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(
    samples: npt.NDArray[np.integer[Any]],
    colour_type: int,
    depth: int = 8,
    before: bytes = b"",
    interlaced: bool = False,
    after: bytes = b"",
) -> bytes:
    """A PNG of (H, W, C) samples; ``before`` and ``after`` are whole chunks around the image data."""
    height, width = samples.shape[:2]
    header = struct.pack(">IIBBBBB", width, height, depth, colour_type, 0, 0, int(interlaced))
    passes = [samples[y0::dy, x0::dx] for x0, y0, dx, dy in ADAM7] if interlaced else [samples]
    raw = b"".join(b"\0" + _row(line, depth) for part in passes if part.size for line in part)
    data = chunk(b"IDAT", zlib.compress(raw))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + before + data + after + chunk(b"IEND", b"")


def _row(line: npt.NDArray[np.integer[Any]], depth: int) -> bytes:
    if depth >= 8:
        return line.astype(">u2" if depth == 16 else "u1").tobytes()
    bits = (line.reshape(-1, 1) >> np.arange(depth - 1, -1, -1)) & 1
    return np.packbits(bits.astype(np.uint8).ravel()).tobytes()


def png_header(width: int, height: int) -> bytes:
    """A PNG that is only its header and an empty data chunk."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def png_bomb(side: int = 30_000) -> bytes:
    """A sound PNG of ``side`` squared black 1-bit pixels in few bytes."""
    packer = zlib.compressobj(9)
    row = bytes(1 + (side + 7) // 8)
    packed = b"".join(packer.compress(row) for _ in range(side)) + packer.flush()
    header = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def zeros_packed(count: int) -> bytes:
    packer = zlib.compressobj(9)
    block = bytes(1_000_000)
    return b"".join(packer.compress(block) for _ in range(count // len(block))) + packer.flush()


def text_bomb(kind: bytes) -> bytes:
    """A PNG whose zTXt, iTXt or iCCP chunk unpacks to 100 MB."""
    head = {b"zTXt": b"Comment\0\0", b"iTXt": b"Comment\0\1\0\0\0", b"iCCP": b"profile\0\0"}[kind]
    return png(picture(), 2, before=chunk(kind, head + zeros_packed(100_000_000)))


def apng(frames: int) -> bytes:
    images = [Image.fromarray(picture(seed=seed)) for seed in range(frames)]
    return save(images[0], "PNG", save_all=True, append_images=images[1:])


# --- JPEG ---


def jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """(marker, body, entropy-coded data after it) of a well-formed JPEG, for taking one apart in tests."""
    position = 2
    while data[position + 1] != 0xD9:
        marker = data[position + 1]
        length = struct.unpack(">H", data[position + 2 : position + 4])[0]
        body = data[position + 4 : position + 2 + length]
        position += 2 + length
        start = position
        while marker == 0xDA and (
            data[position] != 0xFF or data[position + 1] == 0 or 0xD0 <= data[position + 1] < 0xD8
        ):
            position += 1
        yield marker, body, data[start:position]


def segment(marker: int, body: bytes) -> bytes:
    return bytes((0xFF, marker)) + struct.pack(">H", len(body) + 2) + body


def insert(data: bytes, *segments: bytes) -> bytes:
    """Put segments right behind the start of a JPEG."""
    return data[:2] + b"".join(segments) + data[2:]


def many_scans(scans: int, width: int = 96, height: int = 80) -> bytes:
    """A progressive JPEG with its last scan repeated until there are ``scans``."""
    data = save(picture(width, height), "JPEG", progressive=True)
    parts = list(jpeg_segments(data))
    start = sum(marker == 0xDA for marker, _, _ in parts)
    _, body, entropy = parts[-1]
    return data[:-2] + (segment(0xDA, body) + entropy) * (scans - start) + b"\xff\xd9"


def jpeg_header(width: int, height: int) -> bytes:
    """A small JPEG whose frame header claims another size."""
    data = save(picture(), "JPEG")
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + struct.pack(">HH", height, width) + data[at + 4 :]


def cmyk_jpeg(ink: Sequence[int], *, ycck: bool = False, width: int = 96, height: int = 80) -> bytes:
    """One flat colour as four-ink JPEG with an Adobe marker; ``ink`` is (c, m, y, k), 255 = full ink.

    Pillow's writer stores 255 minus what it is given (Adobe's convention). For YCCK the first three stored planes are
    the YCbCr transform of the ink itself, and the marker's last byte says so.
    """
    stored = [255 - value for value in ink]
    if ycck:
        c, m, y = ink[:3]
        luma = 0.299 * c + 0.587 * m + 0.114 * y
        stored[:3] = [round(luma), round(128 + (y - luma) / 1.772), round(128 + (c - luma) / 1.402)]
    image = Image.new("CMYK", (width, height), tuple(255 - value for value in stored))
    data = save(image, "JPEG", quality=100)
    at = data.index(b"Adobe") + 11
    return data[:at] + bytes((2 if ycck else 0,)) + data[at + 1 :]


# --- WebP ---


def webp_animation(frames: int = 3) -> bytes:
    images = [Image.fromarray(picture(seed=seed)) for seed in range(frames)]
    return save(images[0], "WEBP", save_all=True, append_images=images[1:])


# --- metadata ---


def exif(order: str = ">", orientation: int | None = 1, focal: int | None = None, sides: Sequence[int] = ()) -> bytes:
    """TIFF-structured EXIF; ``order`` is '>' or '<', ``sides`` the pixel dimensions that it states."""
    sub = [(0xA002 + i, 4, side) for i, side in enumerate(sides)]
    sub += [] if focal is None else [(0xA405, 3, focal)]
    main = [] if orientation is None else [(0x0112, 3, orientation)]
    start = 8 + 2 + 12 * (len(main) + 1) + 4
    main.append((0x8769, 4, start))
    magic = (b"MM" if order == ">" else b"II") + struct.pack(order + "HI", 42, 8)
    return magic + _directory(order, main) + _directory(order, sub)


def _directory(order: str, entries: Sequence[tuple[int, int, int]]) -> bytes:
    body = struct.pack(order + "H", len(entries))
    for tag, kind, value in entries:
        packed = struct.pack(order + "HH", value, 0) if kind == 3 else struct.pack(order + "I", value)
        body += struct.pack(order + "HHI", tag, kind, 1) + packed
    return body + struct.pack(order + "I", 0)


def with_exif(data: bytes, tiff: bytes) -> bytes:
    """The same JPEG with an EXIF segment."""
    return insert(data, segment(0xE1, b"Exif\0\0" + tiff))


def with_icc(data: bytes, profile: bytes) -> bytes:
    """The same JPEG with a profile in as many segments as it takes."""
    parts = [profile[i : i + 65_000] for i in range(0, len(profile), 65_000)]
    return insert(
        data, *(segment(0xE2, b"ICC_PROFILE\0" + bytes((i + 1, len(parts))) + part) for i, part in enumerate(parts))
    )


BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
D50, D65 = np.array([0.9642, 1.0, 0.8249]), np.array([0.95047, 1.0, 1.08883])


def primaries_to_xyz(xy: Sequence[Sequence[float]]) -> npt.NDArray[np.float64]:
    """3x3 from linear RGB with D65 white to XYZ, from the chromaticities of the primaries."""
    columns = np.array([[x / y, 1, (1 - x - y) / y] for x, y in xy]).T
    return np.asarray(columns * np.linalg.solve(columns, D65))


def matrix_profile(xy: Sequence[Sequence[float]], curve: float | Sequence[float]) -> bytes:
    """An ICC v4 display profile: primaries, D65 white, and a gamma or the five numbers of the sRGB-like curve."""
    adapt = np.linalg.inv(BRADFORD) @ np.diag((BRADFORD @ D50) / (BRADFORD @ D65)) @ BRADFORD
    colorants = adapt @ primaries_to_xyz(xy)
    numbers = [curve] if isinstance(curve, float) else list(curve)
    kind = {1: 0, 5: 3}[len(numbers)]
    para = b"para" + struct.pack(">IHH", 0, kind, 0) + b"".join(_fixed(number) for number in numbers)
    tags = {
        b"desc": _text("test"),
        b"cprt": _text("none"),
        b"wtpt": _xyz(D50),
        b"rXYZ": _xyz(colorants[:, 0]),
        b"gXYZ": _xyz(colorants[:, 1]),
        b"bXYZ": _xyz(colorants[:, 2]),
        b"rTRC": para,
        b"gTRC": para,
        b"bTRC": para,
    }
    table, body = struct.pack(">I", len(tags)), b""
    for name, value in tags.items():
        table += name + struct.pack(">II", 132 + 12 * len(tags) + len(body), len(value))
        body += value + b"\0" * (-len(value) % 4)
    head = struct.pack(
        ">I4sI4s4s4s12x4s", 132 + 12 * len(tags) + len(body), b"", 0x04000000, b"mntr", b"RGB ", b"XYZ ", b"acsp"
    )
    return head.ljust(68, b"\0") + _fixed(0.9642) + _fixed(1.0) + _fixed(0.8249) + bytes(48) + table + body


def _fixed(value: float) -> bytes:
    return struct.pack(">i", round(value * 65536))


def _xyz(value: npt.NDArray[np.float64]) -> bytes:
    return b"XYZ \0\0\0\0" + b"".join(_fixed(v) for v in value)


def _text(text: str) -> bytes:
    return b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", 2 * len(text), 28) + text.encode("utf-16-be")


P3_PRIMARIES = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))
ADOBE_PRIMARIES = ((0.640, 0.330), (0.210, 0.710), (0.150, 0.060))
SRGB_PRIMARIES = ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060))
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


# --- what is no photo at all ---

NOT_IMAGES: dict[str, bytes] = {
    "text": b"hello, this is not a photo\n" * 10,
    "html": b"<!DOCTYPE html><html><body><script>alert(1)</script></body></html>",
    "pdf": b"%PDF-1.7\n1 0 obj\n<<>>\nendobj\n",
    "zip": b"PK\x03\x04" + bytes(100),
    "svg": b'<svg xmlns="http://www.w3.org/2000/svg" width="900" height="900"><image href="file:///etc/passwd"/></svg>',
    "svg with xml head": b'\xef\xbb\xbf<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg"/>',
    "postscript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 300 300\n(%pipe%touch pwned) (w) file\n%%EOF\n",
    "eps with preview": b"\xc5\xd0\xd3\xc6" + bytes(40),
    "psd": b"8BPS\0\1" + bytes(60),
    "tiff little": b"II*\0\x08\0\0\0" + bytes(60),
    "tiff big": b"MM\0*\0\0\0\x08" + bytes(60),
    "fits": b"SIMPLE  =                    T".ljust(2880),
    "ico": b"\0\0\1\0\1\0" + bytes(60),
    "bmp": save(picture(), "BMP"),
    "gif": save(picture(), "GIF"),
    "openexr": b"v/1\x01\x02\0\0\0" + bytes(60),
    "hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 8\n",
    "pfm with nan": b"PF\n2 2\n-1.0\n" + struct.pack("<12f", *[float("nan")] * 12),
    "float tiff with nan": save(Image.fromarray(np.full((8, 8), np.nan, np.float32)), "TIFF"),
    "jpeg 2000": b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(60),
    "jpeg xl": b"\xff\x0a" + bytes(60),
    "avif": b"\0\0\0\x20ftypavif" + bytes(60),
    "mp4": b"\0\0\0\x20ftypisom" + bytes(60),
    "wave": b"RIFF\x24\0\0\0WAVEfmt " + bytes(60),
    "zeros": bytes(1000),
    "one byte": b"\xff",
    "jpeg magic only": b"\xff\xd8",
}
