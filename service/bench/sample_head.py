"""Input of the stages' benchmarks: the sample photo's head, and a window of its chart on the face.

It lies in files of one folder, so that every variant can run in a separate process.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import Float32, UInt8
from service.colour import Codes
from service.levels import FULL_SIZE, SMALLEST_ENLARGED, TEXTURE_SIZE
from service.reflectance.planes import Planes
from service.reflectance.relief.displacement import Steps
from service.reflectance.subject import GEOMETRY_SIZE, Subject
from service.reflectance.super_resolution import resample
from service.runtime.network_registry import CLUES, GEOMETRY

GRID = 64
"""Alignment of windows in texels of the full chart, so that they begin at whole texels of every coarser map."""

FILE = "material.npz"

ARRAYS = ("texture", "geometry", "clues", "steps", "skin")
"""Fields of :class:`SampleHead` in the file, besides the window."""


@dataclass(frozen=True)
class Window:
    """A square of the chart in texels of the full one: left, top and side are multiples of ``GRID``."""

    left: int
    top: int
    side: int

    @classmethod
    def around(cls, weight: npt.NDArray[Any], side: int) -> Window:
        """The window centred on the mean position of a weight (h, w) >= 0 on the whole chart."""
        width, height = FULL_SIZE
        side = min(max(side // GRID, 1) * GRID, height)
        rows, columns = (np.asarray(weight, np.float64).sum(axis) for axis in (1, 0))
        corner = []
        for mass, length in ((columns, width), (rows, height)):
            share = (np.arange(len(mass)) + 0.5) @ mass / mass.sum() / len(mass) if mass.sum() > 0 else 0.5
            first = round((share * length - side / 2) / GRID) * GRID
            corner.append(min(max(first, 0), length - side))
        return cls(corner[0], corner[1], side)

    def of(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The part of a map of the whole chart (H, W, ...) that lies in the window."""
        height, width = values.shape[:2]
        columns, rows = self._span(self.left, width / FULL_SIZE[0]), self._span(self.top, height / FULL_SIZE[1])
        return values[rows, columns]

    def planes(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The same for planes (C, H, W)."""
        return np.moveaxis(self.of(np.moveaxis(values, 0, 2)), 2, 0)

    def pixels(self, width: int) -> int:
        """Side of the window on a chart ``width`` texels wide."""
        return max(round(self.side * width / FULL_SIZE[0]), 1)

    def _span(self, start: int, scale: float) -> slice:
        first = round(start * scale)
        return slice(first, first + max(round(self.side * scale), 1))


@dataclass(frozen=True)
class SampleHead:
    """One head.

    Attributes:
        folder: of the files, including the results.
        window: on which stages are measured.
        texture: (h, w, 3) codes of the whole chart, as unwrapped from the photo.
        geometry: (11, h, w) of the whole chart, see ``service.reflectance.subject``.
        clues: (9, h, w) of the whole chart, see ``service.reflectance.subject.CLUES``.
        steps: (3, h, w) of the window, see ``service.reflectance.relief.displacement.Steps``.
        skin: (side, side) uint8 of the window at full size, above 0 where a texel is skin.
    """

    folder: Path
    window: Window
    texture: Codes
    geometry: Float32
    clues: Float32
    steps: Float32
    skin: UInt8

    def save(self) -> None:
        """Write ``FILE``."""
        window = np.array([self.window.left, self.window.top, self.window.side])
        arrays = {name: getattr(self, name) for name in ARRAYS}
        np.savez(self.folder / FILE, window=window, **arrays)

    @classmethod
    def load(cls, folder: Path) -> SampleHead:
        """Read ``FILE``."""
        with np.load(folder / FILE) as file:
            window = Window(*(int(value) for value in file["window"]))
            return cls(folder, window, *(file[name] for name in ARRAYS))

    def result(self, stage: str) -> npt.NDArray[Any]:
        """The reference's map of a stage in the window."""
        return np.asarray(np.load(self.folder / f"{stage}.npy"))

    def has(self, stage: str) -> bool:
        """Whether a stage's reference was computed."""
        return (self.folder / f"{stage}.npy").exists()

    def map_planes(self, width: int) -> Planes:
        """Geometry in the window of a chart ``width`` texels wide."""
        side = self.window.pixels(width)
        planes = Planes((side, side))
        planes.add_coarse(GEOMETRY, self.window.planes(self.geometry))
        planes.add_coarse(CLUES, self.window.planes(self.clues))
        return planes

    def whole_texture(self) -> Planes:
        """Texture, geometry and light of the whole chart: input of zeta and of delta's context."""
        planes = Planes((self.texture.shape[1], self.texture.shape[0]))
        planes.add_codes("texture", self.texture)
        planes.add_coarse(GEOMETRY, self.geometry)
        planes.add_coarse(CLUES, self.clues)
        return planes

    def enlarged(self, width: int) -> Codes:
        """The window's texture on a chart ``width`` texels wide: input of delta."""
        side = self.window.pixels(width)
        source = self.result("zeta") if width >= SMALLEST_ENLARGED and self.has("zeta") else None
        return resample(np.ascontiguousarray(self.window.of(self.texture)) if source is None else source, (side, side))

    def albedo(self, width: int) -> Codes:
        """The reference's diffuse albedo on a chart ``width`` texels wide; the texture where there is no delta."""
        side = self.window.pixels(width)
        return resample(self.result("delta"), (side, side)) if self.has("delta") else self.enlarged(width)

    def chart_steps(self) -> Steps:
        """Steps of the window."""
        along, lean, across = self.steps
        return Steps(along, lean, across, self.steps.shape[2])


def write_sample_head(subject: Subject, texture: UInt8, seen: npt.NDArray[Any], side: int, folder: Path) -> None:
    """Write the material of a head.

    Args:
        subject: the head.
        texture: (h, w, 3) uint8 sRGB of the whole chart, filled outside the islands.
        seen: (h, w) weight: where the face is.
        side: of the window in texels of the full chart.
        folder: to write to.
    """
    window = Window.around(seen, side)
    found = Steps.of(subject.chart, subject.vertices)
    steps = window.planes(np.stack([found.along, found.lean, found.across]))
    # At the geometry's size, which is enough for a mask of comparisons.
    skin = window.of(np.where(subject.chart.mask, subject.skin(GEOMETRY_SIZE), 0).astype(np.uint8))
    codes = texture.astype(np.uint16) * np.uint16(257)
    side = window.pixels(FULL_SIZE[0])
    mask = np.asarray(resized_mask(skin, side))
    SampleHead(folder, window, codes, subject.geometry, subject.clues, steps, mask).save()


def resized_mask(mask: UInt8, side: int) -> UInt8:
    """(side, side) nearest values of a mask."""
    import cv2

    return np.asarray(cv2.resize(np.ascontiguousarray(mask), (side, side), interpolation=cv2.INTER_NEAREST), np.uint8)


def from_photo(data: bytes, texture_size: tuple[int, int] | None, side: int, folder: Path) -> None:
    """Fit a head to a photo and write its material.

    Args:
        data: bytes of the photo.
        texture_size: (width, height) of zeta's input; None for the default.
        side: of the window.
        folder: to write to.

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    from service.options import TEXTURE_MAPS, Options
    from service.pipeline import make_avatar

    avatar = make_avatar(data, Options(maps=TEXTURE_MAPS, size=texture_size or TEXTURE_SIZE, face="largest"))
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    write_sample_head(subject, avatar.texture.texture, avatar.texture.confidence, side, folder)
