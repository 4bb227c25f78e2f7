"""PNG in strips: a map is coded, filtered and compressed a few rows at a time, which avoids a second copy of it.

Each row is filtered by the difference to the pixel on its left ("Sub") and compressed with run lengths and Huffman
codes alone (zlib's ``Z_RLE``). For maps of skin that takes half the time of OpenCV's encoder at its fastest level, a
third with 16 bits, and gives files that are a tenth smaller, as longer matches hardly occur in noise. The same rows
give the same bytes with the same zlib.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.arrays import UInt8, UInt16

Codes = UInt8 | UInt16

ROWS = 64
"""Rows of a strip."""

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}
_SUB = 1
SRGB_PERCEPTUAL = 0
"""Rendering intent of the sRGB chunk."""
_MEMORY = 9
"""zlib's memory level, the highest."""


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


def encode(rows: Rows, *, srgb: bool) -> bytes:
    """PNG bytes, with an sRGB chunk for sRGB colours; data maps get none, so that no reader converts them.

    Raises:
        ValueError: a shape or depth that PNG does not support.
    """
    return b"".join(_chunks(rows, srgb=srgb))


def _chunks(rows: Rows, *, srgb: bool) -> Iterator[bytes]:
    height, width, channels = (*rows.shape, 1)[:3]
    if channels not in _COLOUR_TYPES or rows.bits not in (8, 16) or not height * width:
        raise ValueError(f"PNG has no images of shape {rows.shape} with {rows.bits} bits")
    yield SIGNATURE
    yield chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, rows.bits, _COLOUR_TYPES[channels], 0, 0, 0))
    if srgb:
        yield chunk(b"sRGB", bytes([SRGB_PERCEPTUAL]))
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, _MEMORY, zlib.Z_RLE)
    for first in range(0, height, ROWS):
        packed = packer.compress(_filtered(rows.read(first, min(first + ROWS, height)), channels).data)
        if packed:
            yield chunk(b"IDAT", packed)
    yield chunk(b"IDAT", packer.flush())
    yield chunk(b"IEND", b"")


def _filtered(strip: Codes, channels: int) -> UInt8:
    """(h, 1 + bytes of a row) uint8: the filter type, then each byte minus that of the pixel before."""
    plain: Any = strip if strip.dtype.itemsize == 1 else strip.astype(">u2")
    samples = np.ascontiguousarray(plain).reshape(len(strip), -1).view(np.uint8)
    pixel = channels * strip.dtype.itemsize
    result = np.zeros((len(strip), samples.shape[1] + 1), np.uint8)
    result[:, 0] = _SUB
    result[:, 1 : 1 + pixel] = samples[:, :pixel]
    np.subtract(samples[:, pixel:], samples[:, :-pixel], out=result[:, 1 + pixel :])
    return result


def chunk(kind: bytes, body: bytes) -> bytes:
    """Length, kind, body and check sum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(kind)))
