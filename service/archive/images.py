"""Maps and previews as PNG and JPEG bytes, reproducible."""

from __future__ import annotations

import numpy as np

from service.archive.png import SRGB_PERCEPTUAL, chunk
from service.arrays import AnyFloat, Float32, UInt8, UInt16
from service.errors import NumericFault

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

    Raises:
        NumericFault: as :func:`quantise_normals`.
    """
    return np.asarray(quantise_normals(normals, 8), np.uint8)


def quantise_normals(normals: AnyFloat, bits: int) -> UInt8 | UInt16:
    """(h, w, 3) unit normals in [-1, 1] -> (h, w, 3) codes in 8 or 16 bits, see :func:`normal_coding`.

    Raises:
        NumericFault: where a component is NaN, infinite or outside [-1, 1] by more than rounding.
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


def encode_png(image: UInt8 | UInt16, *, srgb: bool, level: int = 3) -> bytes:
    """(h, w) grey, (h, w, 3) RGB or (h, w, 4) RGBA, uint8 or uint16 -> PNG bytes, with an sRGB chunk for sRGB colours.

    Data maps (normals, confidence) get no colour chunk, so that no reader converts them. ``level`` is zlib's.
    """
    import cv2

    ways = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}
    planes = image if image.ndim == 2 else cv2.cvtColor(image, ways[image.shape[2]])
    done, buffer = cv2.imencode(".png", planes, [cv2.IMWRITE_PNG_COMPRESSION, level])
    if not done:
        raise NumericFault(f"the PNG encoder refused an image of shape {image.shape} and type {image.dtype}")
    data = buffer.tobytes()
    if not srgb:
        return data
    return data[:_AFTER_IHDR] + chunk(b"sRGB", bytes([SRGB_PERCEPTUAL])) + data[_AFTER_IHDR:]


def encode_jpeg(image: UInt8, quality: int = 90) -> bytes:
    """(h, w, 3) RGB uint8 sRGB -> baseline JPEG bytes without metadata, 4:4:4."""
    import cv2

    settings = [
        cv2.IMWRITE_JPEG_QUALITY, quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]  # fmt: skip
    done, buffer = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)
    if not done:
        raise NumericFault(f"the JPEG encoder refused an image of shape {image.shape} and type {image.dtype}")
    return buffer.tobytes()
