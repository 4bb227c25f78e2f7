"""OpenEXR files of half floats with ZIP compression (OpenEXR file layout, version 2, scan lines of 16 rows).

Values of an EXR are linear by definition, so that readers that take any other texture for sRGB, as Blender does with
all maps of an MTL file, take these as they are.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from service.arrays import Float32, UInt8

_MAGIC, _VERSION = 20000630, 2
_HALF, _ZIP, _ROWS = 1, 3, 16


def exr_bytes(image: Float32) -> bytes:
    """An image (h, w) grey or (h, w, 3) RGB, linear, as EXR; the same image gives the same bytes.

    Raises:
        ValueError: another shape.
    """
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ValueError(f"an image of shape {image.shape}; (h, w) or (h, w, 3) is right")
    height, width = image.shape[:2]
    half = image.astype("<f2")
    # Channels are in the order of their names, each row of one after the other.
    planes = half[:, None, :] if image.ndim == 2 else half[..., ::-1].transpose(0, 2, 1)
    header = _header("Y" if image.ndim == 2 else "BGR", width, height)
    chunks = []
    for first in range(0, height, _ROWS):
        raw = np.ascontiguousarray(planes[first : first + _ROWS]).tobytes()
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


def _header(channels: str, width: int, height: int) -> bytes:
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
    return struct.pack("<ii", _MAGIC, _VERSION) + body + b"\0"
