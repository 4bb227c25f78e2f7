"""Reads OpenEXR files as the specification of the layout says; shares no code with the writer."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt


def read(data: bytes) -> dict[str, npt.NDArray[np.float16]]:
    """Channels of a scan-line file of halves with ZIP compression."""
    assert struct.unpack_from("<ii", data) == (20000630, 2)
    at, fields = 8, {}
    while data[at]:
        name_end = data.index(0, at)
        kind_end = data.index(0, name_end + 1)
        (size,) = struct.unpack_from("<i", data, kind_end + 1)
        start = kind_end + 5
        fields[data[at:name_end].decode()] = data[start : start + size]
        at = start + size
    at += 1
    left, top, right, bottom = struct.unpack("<4i", fields["dataWindow"])
    assert (left, top) == (0, 0) and fields["compression"] == b"\3" and fields["displayWindow"] == fields["dataWindow"]
    names, listed = [], fields["channels"]
    while listed[0]:
        end = listed.index(0)
        assert struct.unpack_from("<i", listed, end + 1) == (1,), "half"
        names.append(listed[:end].decode())
        listed = listed[end + 17 :]
    assert names == sorted(names)
    width, height = right + 1, bottom + 1
    found = {name: np.zeros((height, width), np.float16) for name in names}
    for first, offset in zip(range(0, height, 16), struct.unpack_from(f"<{-(-height // 16)}Q", data, at), strict=True):
        row, size = struct.unpack_from("<ii", data, offset)
        assert row == first
        rows = min(16, height - first)
        block = data[offset + 8 : offset + 8 + size]
        if size < rows * len(names) * width * 2:
            block = undone(zlib.decompress(block))
        values = np.frombuffer(block, "<f2").reshape(rows, len(names), width)
        for index, name in enumerate(names):
            found[name][first : first + rows] = values[:, index]
    return found


def undone(packed: bytes) -> bytes:
    """Predictor and interleaving of the ZIP compression undone: each byte is the sum of those before, less 128 each."""
    steps = np.frombuffer(packed, np.uint8).astype(np.int64)
    steps[1:] -= 128
    values = (np.cumsum(steps) & 255).astype(np.uint8)
    half = (len(values) + 1) // 2
    result = np.zeros_like(values)
    result[0::2], result[1::2] = values[:half], values[half:]
    return result.tobytes()
