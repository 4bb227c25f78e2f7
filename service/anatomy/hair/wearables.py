"""Meshes that follow the head: hair, lashes, brows and the bust; files of them, and what of a photo they would cover.

Every vertex of an item is a point beside the head that it was fitted to, plus a weighted mean of how a few vertices of
that head have moved since. So items follow identity, and where they should, expression. ``python -m
models.people.tailor`` makes the files from MakeHuman's assets (CC0).

Hair on a head follows identity, keeps off the skin, and is as full as the photo's.
"""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from service.arrays import AnyFloat, Float32, Float64, Int32, Int64, UInt8
from service.errors import ModelFault
from service.geometry.camera import Camera
from service.geometry.normals import area_normals
from service.geometry.raster import fragments, interpolate, rasterise
from service.geometry.sampling import sample_chart
from service.head.model import HeadModel
from service.head.regions import vertex_mask

FILE = Path(__file__).resolve().parents[2] / "data" / "hair" / "hair.npz"


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


CLEARANCE_M = 0.002
"""Least distance of hair from the skin: less, and the skin shows through between the vertices."""
DEEPEST_M = 0.025
"""Distance from the skin up to which volume counts: a ponytail is not the body of the hair."""
REACH_M = 0.03
"""Hair further inside the head than this is not pushed out: it belongs to the inside of a style."""
EAR_M = -0.035
"""Height of the ears' lobes below the eyes, from where on hair hangs."""


@dataclass(frozen=True)
class Cut:
    """How a style is worn.

    Attributes:
        volume: factor on the distance of hair from the skull, within 25 mm of it.
        length: factor on how far hair hangs below the ears.
        mirrored: left and right exchanged, for a parting on the other side.
    """

    volume: float = 1.0
    length: float = 1.0
    mirrored: bool = False


def fits(items: Items, head: HeadModel) -> bool:
    """Whether a head has the vertices that the items follow, where they were fitted: other heads wear nothing."""
    if items.fitted_head.shape != head.mean.shape:
        return False
    return bool(np.abs(items.fitted_head - head.mean).max() < 0.02)


def mirrored(item: Item, head: HeadModel) -> Item:
    """The item with left and right exchanged; the head's two halves have to be each other's mirror image."""
    return replace(
        item,
        rest=item.rest * np.array([-1, 1, 1], np.float32),
        follow=head.mirror[item.follow],
        triangles=np.ascontiguousarray(item.triangles[:, ::-1]),
    )


@dataclass(frozen=True)
class Skull:
    """The skin of one head that hair is kept off.

    Attributes:
        head: topology.
        neutral: (V, 3) float32 metres, without expression.
        skin: (M, 3) points of the outer skin without ears, over or behind which hair lies; normals: (M, 3) unit.
        tree: nearest of these points.
    """

    head: HeadModel
    neutral: Float32
    skin: Float64
    normals: Float64
    tree: cKDTree

    @classmethod
    def of(cls, head: HeadModel, neutral: AnyFloat) -> Skull:
        """Of a head (V, 3) without expression."""
        own = np.unique(head.triangles[head.triangle_part == 0])
        own = own[vertex_mask(head, "mouth_inner", "eye_socket", "ear_left", "ear_right")[own] < 0.5]
        points = np.asarray(neutral, np.float32)
        skin = points[own].astype(np.float64)
        return cls(head, points, skin, area_normals(points, head.triangles)[own].astype(np.float64), cKDTree(skin))

    def nearest(self, points: AnyFloat) -> tuple[Int64, Float64, Float64]:
        """Index of the nearest point of the skin, distance above it along its normal, and that normal."""
        index = np.asarray(self.tree.query(points)[1], np.int64)
        normal = self.normals[index]
        return index, np.asarray(np.einsum("ni,ni->n", points - self.skin[index], normal)), normal


def hair_on(item: Item, items: Items, skull: Skull, cut: Cut = Cut()) -> Float32:
    """(N, 3) float32 metres of a style on a head, off its skin.

    Args:
        item: the style.
        items: the file that it is from.
        skull: of the head.
        cut: volume and length.
    """
    item = mirrored(item, skull.head) if cut.mirrored else item
    points = item.worn(skull.neutral - items.fitted_head).astype(np.float64)
    if cut.length != 1.0:
        points[:, 1] += (cut.length - 1.0) * np.minimum(points[:, 1] - EAR_M, 0.0)
    _, away, normal = skull.nearest(points)
    # What hangs is not nearer the neck for being thinner.
    thicker = (cut.volume - 1.0) * np.clip(away, 0.0, DEEPEST_M)
    moved = np.where(points[:, 1] > EAR_M, away + thicker, away)
    moved = np.where((moved < CLEARANCE_M) & (away > -REACH_M), CLEARANCE_M, moved)
    return np.asarray(points + (moved - away)[:, None] * normal, np.float32)


OPAQUE = 0.5
"""Alpha from which a texel of a card counts as hair."""


@dataclass(frozen=True)
class Frame:
    """A part of the photo in which silhouettes are compared, ``side`` pixels wide and high.

    Attributes:
        camera: of the photo.
        place: photo pixels (N, 2) -> pixels of the frame (N, 2).
        side: pixels.
        behind: (side, side) float32 metres, depth of the head without hair; inf beside it.
        scalp: (side, side) float32 in [0, 1], the head's scalp where nothing stands before it.
        below: (side, side) float32 1 below the ears, as the head stands in the photo, 0 above.
    """

    camera: Camera
    place: Callable[[Float64], Float64]
    side: int
    behind: Float32
    scalp: Float32
    below: Float32

    @classmethod
    def of(
        cls, camera: Camera, place: Callable[[Float64], Float64], side: int, head: HeadModel, vertices: AnyFloat,
        scalp: Float32,
    ) -> Frame:  # fmt: skip
        """Draw the head.

        Args:
            camera: of the photo.
            place: photo pixels -> pixels of the frame.
            side: of the frame, pixels.
            head: its topology.
            vertices: (V, 3) metres, with the photo's expression.
            scalp: (V,) soft mask.
        """
        flat, depth = place(camera.project(vertices)), camera.to_camera(vertices)[:, 2]
        drawn = rasterise(flat, depth, head.triangles, side, side, cull=True, perspective=True)
        shown = np.flatnonzero(drawn.mask)
        mask = np.zeros(side * side, np.float32)
        corners = head.triangles[drawn.triangle.ravel()[shown]]
        mask[shown] = interpolate(scalp[:, None], corners, drawn.barycentric.reshape(-1, 3)[shown])[:, 0]
        line = place(camera.project(np.array([[0.0, EAR_M, -0.06], [0.0, EAR_M - 0.05, -0.06]])))
        down = (line[1] - line[0]) / max(float(np.linalg.norm(line[1] - line[0])), 1e-9)
        y, x = np.mgrid[:side, :side] + 0.5
        below = ((x - line[0, 0]) * down[0] + (y - line[0, 1]) * down[1] > 0).astype(np.float32)
        return cls(camera, place, side, drawn.depth, mask.reshape(side, side), below)

    def hair(self, item: Item, points: AnyFloat, behind: float = 0.0) -> tuple[Float32, Float32]:
        """(side, side) float32 1 where a style shows, and there its coordinate from root to tip, 0 elsewhere.

        Args:
            item: the style.
            points: (N, 3) its vertices on the head.
            behind: metres behind the head's surface up to which it is drawn.
        """
        pixel, triangle, share = self.nearest(item, points, behind)
        mask, along = (np.zeros(self.side**2, np.float32) for _ in range(2))
        mask[pixel] = 1.0
        if item.along is not None:
            along[pixel] = interpolate(item.along[:, None], item.triangles[triangle], share)[:, 0]
        return mask.reshape(self.side, -1), along.reshape(self.side, -1)

    def nearest(self, item: Item, points: AnyFloat, behind: float = 0.0) -> tuple[Int64, Int64, Float32]:
        """Pixels (N,) where a style shows, row by row, and there its triangle (N,) and barycentric coordinates (N, 3).

        Args:
            item: the style.
            points: (N, 3) its vertices on the head.
            behind: metres behind the head's surface up to which it is drawn.
        """
        flat, depth = self.place(self.camera.project(points)), self.camera.to_camera(points)[:, 2]
        found = fragments(flat, depth, item.triangles, self.side, self.side, nearer=self.behind + np.float32(behind))
        uv = interpolate(item.uv, item.triangles[found.triangle], found.barycentric)
        solid = np.flatnonzero(sample_chart(item.picture, uv)[:, -1] > 255 * OPAQUE)
        pixel, first = np.unique(found.pixel[solid], return_index=True)
        return pixel, found.triangle[solid[first]], found.barycentric[solid[first]]


def agreement(shown: Float32, mask: Float32, known: Float32) -> float:
    """Intersection over union of soft masks (h, w) in [0, 1], where the photo tells; 0 where both are empty."""
    union = float((np.maximum(shown, mask) * known).sum())
    return float((np.minimum(shown, mask) * known).sum()) / union if union > 0 else 0.0
