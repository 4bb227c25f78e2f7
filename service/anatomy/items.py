"""Meshes that follow the head: lashes, brows, the bust, teeth, gums and tongue, and the files that hold them.

Every vertex is a point beside the head that it was fitted to, plus a weighted mean of how a few vertices of that head
have moved since. So meshes follow identity, and where they should, expression. ``python -m models.people.tailor`` and
``models.people.inside`` make the files from MakeHuman's assets (CC0).
"""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, AnyInt, Float32, Int32, UInt8
from service.errors import ModelFault
from service.face.fit.fit import Fit
from service.geometry.raster import interpolate
from service.head.model import HeadModel
from service.materials.material import Material
from service.materials.part import MeshPart, targets_of

DATA = Path(__file__).resolve().parents[1] / "data"
FILE, MOUTH_FILE = DATA / "hair" / "wearables.npz", DATA / "head" / "mouth.npz"
"""What is worn; and teeth, gums and tongue."""


@dataclass(frozen=True)
class Item:
    """One thing that is worn.

    Attributes:
        name: kind and name, "hair/bob01".
        rest: (N, 3) float32 metres in head space, on the head that it was fitted to.
        follow: (N, k) int32 vertices of the head; share: (N, k) float32 their weights, sum 1.
        uv: (N, 2) float32, origin bottom left.
        triangles: (T, 3) int32.
        picture: (H, W, C) uint8; C is 1 (alpha), 2 (grey and alpha), 3 (sRGB) or 4 (sRGB and alpha).
        along: (N,) float32 in [0, 1], 0 at the roots and 1 at the tips; None where that means nothing.
    """

    name: str
    rest: Float32
    follow: Int32
    share: Float32
    uv: Float32
    triangles: Int32
    picture: UInt8
    along: Float32 | None = None

    def worn(self, moved: AnyFloat) -> Float32:
        """(N, 3) float32 vertices on a head whose vertices less those that it was fitted to are (V, 3) metres."""
        return self.rest + self.moved(moved)

    def moved(self, moved: AnyFloat) -> Float32:
        """(N, 3) float32 by how much the vertices follow a movement (V, 3) of the head."""
        return interpolate(np.asarray(moved, np.float32), self.follow, self.share)


@dataclass(frozen=True, eq=False)
class Inset:
    """One mesh inside the mouth.

    Attributes:
        name: of the part.
        rest, follow, share: as of an :class:`Item`.
        faces: (F, 3) or (F, 4) int32, counter-clockwise from outside; uv_faces: the same into ``uv``.
        uv: (U, 2) float32 in [0, 1], origin bottom left.
        along: (N,) float32 in [0, 1] from the biting edge of a tooth to its gum, -1 on gums; on the tongue from the tip
            to the root.
        shade: (N,) float32 in [0, 1], 0 deep between two teeth and 1 in the open.
    """

    name: str
    rest: Float32
    follow: Int32
    share: Float32
    faces: Int32
    uv: Float32
    uv_faces: Int32
    along: Float32
    shade: Float32

    def moved(self, offsets: AnyFloat) -> Float32:
        """(N, 3) float32 metres by which it follows offsets (V, 3) of the head."""
        return np.asarray(interpolate(np.asarray(offsets, np.float64), self.follow, self.share), np.float32)


@dataclass(frozen=True)
class Items:
    """All items of a file by name, and the head (V, 3) float32 metres that they were fitted to."""

    items: dict[str, Item]
    fitted_head: Float32

    def names(self, kind: str) -> list[str]:
        """Sorted names of a kind, with the kind before the stroke: "hair" gives "hair/afro01" ..."""
        return sorted(name for name in self.items if name.startswith(kind + "/"))


@dataclass(frozen=True, eq=False)
class Insets:
    """Meshes, and the mean head (V, 3) float32 metres that they were made for."""

    meshes: tuple[Inset, ...]
    fitted_head: Float32


def _read(path: Path, maker: str, item: Callable[[str, dict[str, npt.NDArray[Any]]], Any]) -> tuple[list[Any], Any]:
    """The meshes of a file, made of its arrays by name, and the head that they were fitted to; ModelFault if not."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        fitted = arrays.pop("fitted_head")
        return [item(name, arrays) for name in dict.fromkeys(key.rpartition(":")[0] for key in arrays)], fitted
    except FileNotFoundError:
        raise ModelFault(f"{path} is missing; build it with python -m {maker} --assets FOLDER") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as fault:
        raise ModelFault(f"{path} cannot be read: {fault}") from fault


@functools.lru_cache(maxsize=2)
def read_items(path: Path = FILE) -> Items:
    """Read a file of what is worn; ModelFault where it is missing or cannot be read."""
    items, fitted = _read(path, "models.people.tailor", _item)
    return Items({item.name: item for item in sorted(items, key=lambda item: item.name)}, fitted)


def _item(name: str, arrays: dict[str, npt.NDArray[Any]]) -> Item:
    def get(key: str) -> npt.NDArray[Any]:
        return arrays[f"{name}:{key}"]

    uv = get("uv").astype(np.float32) / 65535.0 * 4.0 - 2.0
    share = get("share").astype(np.float32) / 1000.0
    rest = get("rest").astype(np.float32) * 1e-5
    along = get("along").astype(np.float32) / 255.0 if f"{name}:along" in arrays else None
    return Item(
        name, rest, get("follow").astype(np.int32), share, uv, get("triangles").astype(np.int32),
        np.asarray(get("picture"), np.uint8), along,
    )  # fmt: skip


@functools.lru_cache(maxsize=2)
def read_insets(path: Path = MOUTH_FILE) -> Insets:
    """Read a file of teeth, gums and tongue; ModelFault where it is missing or cannot be read."""
    keys = [field.name for field in fields(Inset) if field.name != "name"]
    meshes, fitted = _read(
        path, "models.people.inside", lambda name, arrays: Inset(name, *(arrays[f"{name}:{key}"] for key in keys))
    )
    return Insets(tuple(meshes), fitted)


def fits(made: Items | Insets, head: HeadModel) -> bool:
    """Whether a head has the vertices that meshes follow, where they were fitted: other heads wear nothing."""
    same = made.fitted_head.shape == head.mean.shape
    return same and bool(np.abs(made.fitted_head - head.mean).max() < 0.02)


def following(
    name: str, head: HeadModel, fit: Fit, fitted: AnyFloat, rest: AnyFloat, moved: Callable[[AnyFloat], AnyFloat],
    faces: AnyInt, uv: Float32, material: Material, *, lift: AnyFloat | float = 0.0, **more: Any,
) -> MeshPart:  # fmt: skip
    """A mesh that follows identity and expression of a head.

    Args:
        name: of the part.
        head: topology and units.
        fit: vertices of the head.
        fitted: (V, 3) metres, the head that it was fitted to.
        rest: (N, 3) metres, its vertices there.
        moved: from offsets (V, 3) of the head to those (N, 3) of the mesh, metres.
        faces: (F, 3) or (F, 4) indices.
        uv: places on its picture.
        material: its surface.
        lift: (N, 3) metres that its vertices are moved by.
        more: what else a :class:`MeshPart` has.
    """
    vertices, neutral = (
        np.asarray(rest + moved(shape - fitted) + lift, np.float32) for shape in (fit.vertices, fit.neutral)
    )
    targets = targets_of(head, moved)
    return MeshPart(name, vertices, neutral, np.asarray(faces, np.int32), uv, material, targets=targets, **more)
