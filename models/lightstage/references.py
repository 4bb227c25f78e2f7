"""Pieces of real skin to compare with, from a folder of reference scans that is not part of the program."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from models.lightstage.measures import Patch, slopes
from service.errors import UsageError

Array = npt.NDArray[np.float64]

HIFI_PPM = 7.6
"""hifi3d charts of 2048^2: 478 texels between the eyes, taken as 63 mm."""
SCAN_PPM = 2.65
"""Lee Perry-Smith's chart of 1024^2: 167 texels between the eyes."""

_HIFI = (("cheek right", 540, 900), ("cheek left", 1252, 900), ("forehead", 896, 470))
_HIFI_FACE, _SCAN_FACE = (464, 330, 1120), (300, 100, 400)
"""Left and upper end and side of the faces, texels."""
_SCAN = (("cheek right", 385, 320), ("cheek left", 595, 320), ("forehead", 480, 150))


def read(path: Path) -> npt.NDArray[np.uint8]:
    """(h, w, 3) uint8 RGB.

    Raises:
        UsageError: the file is missing or no image.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise UsageError(f"no readable image at {path}: --data must hold hifi3d_uv/ and lee_perry_smith/")
    return np.ascontiguousarray(image[..., ::-1])


def linear(image: npt.NDArray[np.uint8]) -> Array:
    """Linear RGB in [0, 1] of sRGB bytes."""
    x = image.astype(np.float64) / 255.0
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def normals(image: npt.NDArray[np.uint8]) -> Array:
    """(h, w, 3) unit normals of a usual 8-bit map."""
    n = image.astype(np.float64) / 127.5 - 1.0
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-6))


def _cut(name: str, albedo: Array, normal: Array, x: int, y: int, size: int, ppm: float) -> Patch:
    window = (slice(y, y + size), slice(x, x + size))
    slope = slopes(normal[window])
    return Patch(name, albedo[window], slope - slope.mean((1, 2), keepdims=True), ppm)


def reference_patches(data: Path) -> list[Patch]:
    """Cheeks and foreheads of four real people, about 33 and 24 mm wide."""
    patches = []
    for number, end in enumerate(("", "_1", "_2"), 1):
        albedo = linear(read(data / "hifi3d_uv" / f"albedo{end}.png"))
        normal = normals(read(data / "hifi3d_uv" / f"normal{end}.png"))
        patches += [_cut(f"hifi3d {number} {n}", albedo, normal, x, y, 256, HIFI_PPM) for n, x, y in _HIFI]
    albedo = linear(read(data / "lee_perry_smith" / "color.jpg"))
    normal = normals(read(data / "lee_perry_smith" / "normal.jpg"))
    return patches + [_cut(f"LPS {n}", albedo, normal, x, y, 64, SCAN_PPM) for n, x, y in _SCAN]


def reference_faces(data: Path) -> list[Patch]:
    """The whole faces that :func:`reference_patches` cuts from, about 150 mm wide; edges of the charts are left out."""
    faces = []
    for number, end in enumerate(("", "_1", "_2"), 1):
        albedo = linear(read(data / "hifi3d_uv" / f"albedo{end}.png"))
        normal = normals(read(data / "hifi3d_uv" / f"normal{end}.png"))
        faces.append(_cut(f"hifi3d {number}", albedo, normal, *_HIFI_FACE, HIFI_PPM))
    scan = data / "lee_perry_smith"
    colour, relief = linear(read(scan / "color.jpg")), normals(read(scan / "normal.jpg"))
    return [*faces, _cut("LPS", colour, relief, *_SCAN_FACE, SCAN_PPM)]
