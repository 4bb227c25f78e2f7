"""Pieces of real skin to compare with, from a folder of reference scans that is not part of the program."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Layout:
    """Where things are on a chart.

    Attributes:
        texels_per_mm: resolution.
        side: of the patches, texels.
        places: name, left and upper end of each patch.
        face: left and upper end and side of the face.
    """

    texels_per_mm: float
    side: int
    places: tuple[tuple[str, int, int], ...]
    face: tuple[int, int, int]


HIFI = Layout(
    HIFI_PPM, 256, (("cheek right", 540, 900), ("cheek left", 1252, 900), ("forehead", 896, 470)), (464, 330, 1120)
)
SCAN = Layout(
    SCAN_PPM, 64, (("cheek right", 385, 320), ("cheek left", 595, 320), ("forehead", 480, 150)), (300, 100, 400)
)


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


@dataclass(frozen=True)
class _Scan:
    name: str
    albedo: Array
    normal: Array
    layout: Layout

    def cut(self, name: str, x: int, y: int, size: int) -> Patch:
        window = (slice(y, y + size), slice(x, x + size))
        slope = slopes(self.normal[window])
        return Patch(name, self.albedo[window], slope - slope.mean((1, 2), keepdims=True), self.layout.texels_per_mm)


def _scans(data: Path) -> Iterator[_Scan]:
    """One after the other, as each takes some hundred megabytes."""
    for number, end in enumerate(("", "_1", "_2"), 1):
        colour, relief = (data / "hifi3d_uv" / f"{kind}{end}.png" for kind in ("albedo", "normal"))
        yield _Scan(f"hifi3d {number}", linear(read(colour)), normals(read(relief)), HIFI)
    colour, relief = (data / "lee_perry_smith" / f"{kind}.jpg" for kind in ("color", "normal"))
    yield _Scan("LPS", linear(read(colour)), normals(read(relief)), SCAN)


def reference_patches(data: Path) -> list[Patch]:
    """Cheeks and foreheads of four real people, about 33 and 24 mm wide."""
    return [
        scan.cut(f"{scan.name} {name}", x, y, scan.layout.side)
        for scan in _scans(data)
        for name, x, y in scan.layout.places
    ]


def reference_faces(data: Path) -> list[Patch]:
    """The whole faces that :func:`reference_patches` cuts from, about 150 mm wide; edges of the charts are left out."""
    return [scan.cut(scan.name, *scan.layout.face) for scan in _scans(data)]
