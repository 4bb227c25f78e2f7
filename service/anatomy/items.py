"""Meshes that follow the head: lashes, brows and the bust, and files of them.

Every vertex of an item is a point beside the head that it was fitted to, plus a weighted mean of how a few vertices of
that head have moved since. So items follow identity, and where they should, expression. ``python -m
models.people.tailor`` makes the files from MakeHuman's assets (CC0).
"""

from __future__ import annotations

import functools
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Float32, Int32, UInt8
from service.errors import ModelFault
from service.head.model import HeadModel

FILE = Path(__file__).resolve().parents[1] / "data" / "hair" / "wearables.npz"


@dataclass(frozen=True)
class Item:
    """One thing.

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
        """(N, 3) float32 vertices on a head.

        Args:
            moved: (V, 3) the head's vertices less those of the head that the item was fitted to, metres.
        """
        return self.rest + self.moved(moved)

    def moved(self, moved: AnyFloat) -> Float32:
        """(N, 3) float32 by how much the vertices follow a movement (V, 3) of the head."""
        out = np.zeros_like(self.rest)
        for k in range(self.follow.shape[1]):
            out += self.share[:, k : k + 1] * moved[self.follow[:, k]]
        return np.asarray(out, np.float32)


@dataclass(frozen=True)
class Items:
    """All items of a file by name, and the head (V, 3) float32 metres that they were fitted to."""

    items: dict[str, Item]
    fitted_head: Float32

    def names(self, kind: str) -> list[str]:
        """Sorted names of a kind, with the kind before the stroke: "hair" gives "hair/afro01" ..."""
        return sorted(name for name in self.items if name.startswith(kind + "/"))


@functools.lru_cache(maxsize=2)
def read_items(path: Path = FILE) -> Items:
    """Read a file.

    Raises:
        ModelFault: it is missing or cannot be read.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as a:
            arrays = {key: a[key] for key in a.files}
        fitted = arrays.pop("fitted_head")
        names = sorted({key.rsplit(":", 1)[0] for key in arrays})
        return Items({name: _item(name, arrays) for name in names}, fitted)
    except FileNotFoundError:
        raise ModelFault(f"{path} is missing; build it with python -m models.people.tailor --assets FOLDER") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as fault:
        raise ModelFault(f"{path} cannot be read: {fault}") from fault


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


def write_items(items: list[Item], fitted_head: AnyFloat, path: Path) -> None:
    """Write a file; positions are rounded to 10 micrometres. The same items give the same bytes."""
    arrays: dict[str, npt.NDArray[Any]] = {"fitted_head": np.asarray(fitted_head, np.float32)}
    for i in items:
        short = np.int16 if np.abs(i.rest).max() < 0.32 else np.int32
        arrays[f"{i.name}:rest"] = np.round(i.rest * 1e5).astype(short)
        arrays[f"{i.name}:follow"] = i.follow.astype(np.int16)
        arrays[f"{i.name}:share"] = np.round(i.share * 1000).astype(
            np.int16 if np.abs(i.share).max() < 32 else np.int32
        )
        arrays[f"{i.name}:uv"] = np.round((np.clip(i.uv, -2, 2) + 2.0) / 4.0 * 65535).astype(np.uint16)
        arrays[f"{i.name}:triangles"] = i.triangles.astype(np.uint16)
        arrays[f"{i.name}:picture"] = i.picture
        if i.along is not None:
            arrays[f"{i.name}:along"] = np.round(255 * np.clip(i.along, 0, 1)).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def fits(items: Items, head: HeadModel) -> bool:
    """Whether a head has the vertices that the items follow, where they were fitted: other heads wear nothing."""
    if items.fitted_head.shape != head.mean.shape:
        return False
    return bool(np.abs(items.fitted_head - head.mean).max() < 0.02)
