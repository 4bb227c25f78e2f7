"""EXR files are read back as the specification of the layout says, by code that shares nothing with the writer."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt
import pytest

from service.archive.exr import exr_bytes


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
    for first, offset in zip(
        range(0, height, 16), struct.unpack_from(f"<{-(-height // 16)}Q", data, at), strict=True
    ):
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
    """Predictor and interleaving of the ZIP compression undone, byte by byte as in OpenEXR's own loop."""
    values = bytearray(packed)
    for index in range(1, len(values)):
        values[index] = (values[index - 1] + values[index] - 128) & 255
    half = (len(values) + 1) // 2
    result = bytearray(len(values))
    result[0::2], result[1::2] = values[:half], values[half:]
    return bytes(result)


@pytest.mark.parametrize("shape", [(37, 21), (37, 21, 3), (16, 1, 3), (1, 5)])
def test_it_is_read_back(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(4).uniform(-1, 2, shape).astype(np.float32)
    image.reshape(-1)[: image.size // 2] = 0.25  # a part that compresses
    found = read(exr_bytes(image))
    planes = {"Y": image} if image.ndim == 2 else {name: image[..., "RGB".index(name)] for name in "RGB"}
    assert set(found) == set(planes)
    for name, plane in planes.items():
        np.testing.assert_array_equal(found[name], plane.astype(np.float16))


def test_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2, 2\)"):
        exr_bytes(np.zeros((2, 2, 2), np.float32))
