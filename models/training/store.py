"""Captures on disk as a data set that grows while it is read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault
from service.geometry.chart import nearest_inside

Arrays = dict[str, npt.NDArray[np.generic]]


@dataclass
class Wholes:
    """Whole charts at 288 x 192, each under several lights.

    Each item has ``albedo`` (3, h, w) uint8 sRGB, ``texture`` (L, 3, h, w) uint8 sRGB and ``geometry`` (11, h, w)
    float16; texels outside the islands have the value of the nearest inside. ``whites`` is (L, 2, 3) float32, the light
    on the whites of the eyes (``models.lightstage.light.sclera``).
    """

    folder: Path
    items: list[Arrays] = field(default_factory=list)
    _seen: set[str] = field(default_factory=set)

    def refresh(self) -> None:
        """Read the files that came since the last time.

        Raises:
            ModelFault: there is no capture with a whole chart, or one of an older version.
        """
        for path in _new(self.folder, self._seen):
            with np.load(path) as file:
                if "whole_albedo" not in file:  # drawn with patches only
                    continue
                if "whole_whites" not in file:
                    raise ModelFault(f"{path} has no whole_whites; it is of an older version, draw it anew")
                albedo, texture, geometry, whites = (
                    file[f"whole_{n}"] for n in ("albedo", "texture", "geometry", "whites")
                )
            index = nearest_inside(geometry[-1] > 0.5).ravel()
            size = albedo.shape[1:]
            self.items.append(
                {
                    "albedo": albedo.reshape(3, -1)[:, index].reshape(3, *size),
                    "texture": texture.reshape(len(texture), 3, -1)[..., index].reshape(len(texture), 3, *size),
                    "geometry": geometry,
                    "whites": whites,
                    "seed": np.array(int(path.name.split("_")[0])),
                }
            )
        _require(self.items, self.folder)


@dataclass
class Patches:
    """Windows of the chart; each item has the arrays of ``models.training.capture`` that were asked for.

    Attributes:
        folder: of captures.
        wanted: names of arrays.
        full_size_only: leaves out windows of smaller charts.
        unlit_too: takes windows that were not lit as well; their ``texture`` is their albedo.
        items: that have been read.
    """

    folder: Path
    wanted: tuple[str, ...]
    full_size_only: bool = False
    unlit_too: bool = False
    items: list[Arrays] = field(default_factory=list)
    _seen: set[str] = field(default_factory=set)

    def refresh(self) -> None:
        """Read the files that came since the last time.

        Raises:
            ModelFault: there is no capture, or none with what is wanted.
        """
        for path in _new(self.folder, self._seen):
            with np.load(path) as file:
                for i in range(int(file["patches"])):
                    lit = f"patch{i}_texture" in file
                    needed = [name for name in self.wanted if lit or not (self.unlit_too and name == "texture")]
                    if not all(f"patch{i}_{name}" in file for name in needed):
                        continue
                    window = file[f"patch{i}_window"]
                    if self.full_size_only and window[4] != 6144:
                        continue
                    item = {name: file[f"patch{i}_{name}"] for name in needed}
                    if "texture" in self.wanted and not lit:
                        item["texture"] = item["albedo"]
                    item["window"], item["seed"] = window, np.array(int(path.name.split("_")[0]))
                    if (file[f"patch{i}_mask"] > 127).mean() > 0.2:
                        self.items.append(item)
        _require(self.items, self.folder)


def _new(folder: Path, seen: set[str]) -> Iterable[Path]:
    for path in sorted(folder.glob("*.npz")):
        if path.name not in seen:
            seen.add(path.name)
            yield path


def _require(items: list[Arrays], folder: Path) -> None:
    if not items:
        raise ModelFault(
            f"{folder} has no captures; draw some with: python -m models.training.factory -o {folder.parent}"
        )
