"""Maps and previews as PNG, JPEG and OpenEXR bytes: the same pixels give the same bytes.

Large maps are written as PNG in strips: coded, filtered and compressed a few rows at a time, without a second copy.
Each row is filtered by the difference to the pixel on its left ("Sub") and compressed with run lengths and Huffman
codes alone (zlib's ``Z_RLE``). For maps of skin that takes half the time of OpenCV's encoder at its fastest level, a
third with 16 bits, and gives files that are a tenth smaller, as longer matches hardly occur in noise.

Values of an EXR are linear by definition, so that readers that take any other texture for sRGB, as Blender does with
all maps of an MTL file, take these as they are. Half floats, ZIP compression (OpenEXR file layout, version 2).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.arrays import AnyFloat, Float32, UInt8, UInt16
from service.errors import NumericFault

Codes = UInt8 | UInt16

STRIP_ROWS = 64
"""Rows of a strip."""

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}
SRGB_PERCEPTUAL = 0
"""Rendering intent of the sRGB chunk."""


@dataclass(frozen=True)
class Rows:
    """An image that is read in strips.

    Attributes:
        shape: (H, W) or (H, W, C) with 1, 3 or 4 channels: grey, RGB, RGBA.
        bits: per sample, 8 or 16.
        read: first and last row + 1 -> (h, W) or (h, W, C) uint8 or uint16.
    """

    shape: tuple[int, ...]
    bits: int
    read: Callable[[int, int], Codes]

    @classmethod
    def of(cls, image: Codes) -> Rows:
        """The rows of an array."""
        return cls(image.shape, 8 * image.dtype.itemsize, lambda first, last: image[first:last])


def encode_png_rows(rows: Rows, *, srgb: bool) -> bytes:
    """PNG bytes, with an sRGB chunk for sRGB colours; data maps get none, so that no reader converts them."""
    return b"".join(_chunks(rows, srgb=srgb))


def _chunks(rows: Rows, *, srgb: bool) -> Iterator[bytes]:
    height, width, channels = (*rows.shape, 1)[:3]
    yield SIGNATURE
    yield png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, rows.bits, _COLOUR_TYPES[channels], 0, 0, 0))
    if srgb:
        yield png_chunk(b"sRGB", bytes([SRGB_PERCEPTUAL]))
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    for first in range(0, height, STRIP_ROWS):
        packed = packer.compress(_filtered(rows.read(first, min(first + STRIP_ROWS, height)), channels).data)
        if packed:
            yield png_chunk(b"IDAT", packed)
    yield png_chunk(b"IDAT", packer.flush())
    yield png_chunk(b"IEND", b"")


def _filtered(strip: Codes, channels: int) -> UInt8:
    """(h, 1 + bytes of a row) uint8: the filter type, then each byte minus that of the pixel before."""
    plain: Any = strip if strip.dtype.itemsize == 1 else strip.astype(">u2")
    samples = np.ascontiguousarray(plain).reshape(len(strip), -1).view(np.uint8)
    pixel = channels * strip.dtype.itemsize
    result = np.zeros((len(strip), samples.shape[1] + 1), np.uint8)
    result[:, 0] = 1  # "Sub"
    result[:, 1 : 1 + pixel] = samples[:, :pixel]
    np.subtract(samples[:, pixel:], samples[:, :-pixel], out=result[:, 1 + pixel :])
    return result


def png_chunk(kind: bytes, body: bytes) -> bytes:
    """Length, kind, body and check sum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(kind)))


NORMAL_ZERO = 128
NORMAL_SCALE = 127
"""8-bit normals are coded as 128 + 127 n, which represents 0 exactly; ``255 (0.5 n + 0.5)`` does not, so that the
integral of a flat map would be a ramp."""

_AFTER_IHDR = 8 + 25
"""Bytes of the PNG signature and the IHDR chunk."""


def normal_coding(bits: int) -> tuple[int, int]:
    """Code of 0 and codes per unit of normals in 8 or 16 bits: value = (code - zero) / scale."""
    return (NORMAL_ZERO, NORMAL_SCALE) if bits == 8 else (32768, 32767)


def to_8_bits(codes: UInt16) -> UInt8:
    """16-bit codes rounded to 8 bits, any shape."""
    return np.asarray((codes.astype(np.uint32) * 255 + 32767) // 65535, np.uint8)


def encode_normals8(normals: AnyFloat) -> UInt8:
    """(h, w, 3) unit normals in [-1, 1] -> (h, w, 3) uint8 codes; flat (0, 0, 1) becomes (128, 128, 255).

    NumericFault: as :func:`quantise_normals`.
    """
    return np.asarray(quantise_normals(normals, 8), np.uint8)


def quantise_normals(normals: AnyFloat, bits: int) -> UInt8 | UInt16:
    """(h, w, 3) unit normals in [-1, 1] -> (h, w, 3) codes in 8 or 16 bits, see :func:`normal_coding`.

    NumericFault: a component is NaN, infinite or outside [-1, 1] by more than rounding.
    """
    values = np.asarray(normals, np.float32)
    bad = ~(np.abs(values) <= 1.0 + 1e-3)  # NaN compares false, so it counts as bad
    if bad.any():
        y, x, channel = (int(index[0]) for index in np.nonzero(bad))
        raise NumericFault(
            f"{int(bad.sum())} normal components are not in [-1, 1]; the first is {values[y, x, channel]!r} "
            f"at row {y}, column {x}, channel {channel}"
        )
    zero, scale = normal_coding(bits)
    codes = np.rint(np.clip(values, -1.0, 1.0) * np.float32(scale)) + np.float32(zero)
    return np.asarray(codes, np.uint8) if bits == 8 else np.asarray(codes, np.uint16)


def decode_normals8(codes: UInt8) -> Float32:
    """Inverse of :func:`encode_normals8` to within 1/254 per component; not normalised again."""
    return (codes.astype(np.float32) - np.float32(NORMAL_ZERO)) / np.float32(NORMAL_SCALE)


def encode_png(image: UInt8 | UInt16, *, srgb: bool) -> bytes:
    """(h, w) grey, (h, w, 3) RGB or (h, w, 4) RGBA, uint8 or uint16 -> PNG bytes, with an sRGB chunk for sRGB colours.

    Data maps (normals, confidence) get no colour chunk, so that no reader converts them.
    """
    import cv2

    ways = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}
    planes = image if image.ndim == 2 else cv2.cvtColor(image, ways[image.shape[2]])
    data = _encoded(".png", planes, [cv2.IMWRITE_PNG_COMPRESSION, 4])
    if not srgb:
        return data
    return data[:_AFTER_IHDR] + png_chunk(b"sRGB", bytes([SRGB_PERCEPTUAL])) + data[_AFTER_IHDR:]


def encode_jpeg(image: UInt8, quality: int = 90) -> bytes:
    """(h, w, 3) RGB uint8 sRGB -> baseline JPEG bytes without metadata, 4:4:4."""
    import cv2

    settings = [
        cv2.IMWRITE_JPEG_QUALITY, quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]  # fmt: skip
    return _encoded(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)


def _encoded(suffix: str, image: Any, settings: Sequence[int]) -> bytes:
    """What OpenCV's encoder makes; NumericFault where it refuses the image, for which it would give no bytes."""
    import cv2

    done, buffer = cv2.imencode(suffix, image, settings)
    if not done:
        raise NumericFault(f"the {suffix[1:]} encoder refused an image of shape {image.shape} and type {image.dtype}")
    return buffer.tobytes()


_EXR_MAGIC, _EXR_VERSION = 20000630, 2
_HALF, _ZIP, _EXR_ROWS = 1, 3, 16


def exr_bytes(image: Float32) -> bytes:
    """An image (h, w) grey or (h, w, 3) RGB, linear, as EXR, the same for the same."""
    height, width = image.shape[:2]
    half = image.astype("<f2")
    # Channels are in the order of their names, each row of one after the other.
    planes = half[:, None, :] if image.ndim == 2 else half[..., ::-1].transpose(0, 2, 1)
    header = _exr_header("Y" if image.ndim == 2 else "BGR", width, height)
    chunks = []
    for first in range(0, height, _EXR_ROWS):
        raw = np.ascontiguousarray(planes[first : first + _EXR_ROWS]).tobytes()
        packed = zlib.compress(_predicted(np.frombuffer(raw, np.uint8)), 4)
        data = packed if len(packed) < len(raw) else raw
        chunks.append(struct.pack("<ii", first, len(data)) + data)
    offsets, at = [], len(header) + 8 * len(chunks)
    for chunk in chunks:
        offsets.append(at)
        at += len(chunk)
    return b"".join([header, struct.pack(f"<{len(offsets)}Q", *offsets), *chunks])


def _predicted(raw: UInt8) -> bytes:
    """Even bytes before odd ones, each as the difference to the one before plus 128."""
    parted = np.concatenate([raw[0::2], raw[1::2]])
    difference = parted.copy()
    difference[1:] = parted[1:] - parted[:-1] + np.uint8(128)
    return difference.tobytes()


def _exr_header(channels: str, width: int, height: int) -> bytes:
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", _HALF, 0, 1, 1) for name in channels) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    fields = [
        ("channels", "chlist", listed),
        ("compression", "compression", bytes([_ZIP])),
        ("dataWindow", "box2i", box),
        ("displayWindow", "box2i", box),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    body = b"".join(
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data
        for name, kind, data in fields
    )
    return struct.pack("<ii", _EXR_MAGIC, _EXR_VERSION) + body + b"\0"
