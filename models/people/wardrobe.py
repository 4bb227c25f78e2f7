"""What people wear and grow besides skin: meshes that follow the head, with their pictures.

``models/people/data/wardrobe.npz`` holds them; ``python -m models.people.tailor`` makes it from MakeHuman's assets
(CC0). Every vertex of an item is a point of the mean head's neighbourhood plus a weighted mean of how a few vertices of
the head differ from the head that the item was fitted to; so items follow identity, and where they should, expression.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault

Float = npt.NDArray[np.float32]
FILE = Path(__file__).resolve().parent / "data" / "wardrobe.npz"


@dataclass(frozen=True)
class Item:
    """One thing.

    Attributes:
        name: as in the wardrobe, "hair/bob01".
        rest: (N, 3) float32 metres in head space, on the head that it was fitted to.
        follow: (N, k) int32 vertices of the head; share: (N, k) float32 their weights.
        uv: (N, 2) float32, origin bottom left.
        triangles: (T, 3) int32.
        picture: (H, W, C) uint8; C is 1 (alpha), 2 (grey and alpha), 3 (sRGB) or 4 (sRGB and alpha).
    """

    name: str
    rest: Float
    follow: npt.NDArray[np.int32]
    share: Float
    uv: Float
    triangles: npt.NDArray[np.int32]
    picture: npt.NDArray[np.uint8]

    def worn(self, moved: Float) -> Float:
        """(N, 3) float32 vertices on a head.

        Args:
            moved: (V, 3) the head's vertices less those of ``fitted_head``, metres.
        """
        out = self.rest.copy()
        for k in range(self.follow.shape[1]):
            out += self.share[:, k : k + 1] * moved[self.follow[:, k]]
        return out


@dataclass(frozen=True)
class Wardrobe:
    """All items by name, and the head (V, 3) float32 metres that they were fitted to."""

    items: dict[str, Item]
    fitted_head: Float

    def names(self, kind: str) -> list[str]:
        """Sorted names of a kind: "hair", "brow", "lash", "teeth", "hat", "cloth", "torso", "hand", "iris"."""
        return sorted(name for name in self.items if name.startswith(kind + "/"))


@functools.lru_cache(maxsize=2)
def load_wardrobe(path: Path = FILE) -> Wardrobe:
    """Read the file.

    Raises:
        ModelFault: it is missing.
    """
    if not path.is_file():
        raise ModelFault(f"{path} is missing; build it with python -m models.people.tailor --assets FOLDER")
    with np.load(path, allow_pickle=False) as a:
        arrays = {key: a[key] for key in a.files}
    fitted = arrays.pop("fitted_head")
    names = sorted({key.rsplit(":", 1)[0] for key in arrays})

    def item(name: str) -> Item:
        def get(key: str) -> npt.NDArray[np.generic]:
            return arrays[f"{name}:{key}"]

        uv = get("uv").astype(np.float32) / 65535.0 * 4.0 - 2.0
        share = get("share").astype(np.float32) / 1000.0
        rest = get("rest").astype(np.float32) * 1e-5
        return Item(
            name, rest, get("follow").astype(np.int32), share, uv, get("triangles").astype(np.int32),
            np.asarray(get("picture"), np.uint8),
        )  # fmt: skip

    return Wardrobe({name: item(name) for name in names}, fitted)


def pack(items: list[Item], fitted_head: Float, path: Path) -> None:
    """Write a wardrobe; positions are rounded to 10 micrometres."""
    arrays: dict[str, npt.NDArray[np.generic]] = {"fitted_head": np.asarray(fitted_head, np.float32)}
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
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
