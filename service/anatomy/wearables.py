"""What an avatar wears beside its hair: lashes, brows, and the bust, whose shoulders go on from the neck in its colour.

Meshes are made once, coloured as the photo shows them; once the networks have told the albedo of the skin, what is left
of the photo's light is taken off their pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from service.anatomy.canvas import brow_plane
from service.anatomy.items import Item, Items, fits, following, read_items
from service.arrays import Bool, Float32, Float64, Int64, UInt8, UInt16
from service.colour import bytes_to_linear, linear_to_srgb
from service.face.fit.fit import Fit
from service.face.reading.part_labels import BROW
from service.face.reading.reader import PART_CELLS, Reading
from service.geometry.chart import Chart, nearest_inside
from service.geometry.mesh import area_normals, laplacian, smooth_fit, unit
from service.geometry.nearest import Nearest
from service.geometry.raster import fragments, interpolate, rasterise
from service.geometry.remesh import split_in_four
from service.geometry.sampling import sample_chart
from service.hair.colour import natural
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.materials.material import Material, OwnMap
from service.materials.part import SKIN, MeshPart
from service.photo.photo import Photo

BUST = "bust/body"
SIDE = 256
"""Texels along its texture, which holds a smooth colour only."""
BUST_ROUGHNESS = 0.55
SPLITS, ROUNDS = 2, 16
"""Splits of its triangles, and rounds of smoothing afterwards: over the triangles that it had, 18 mm wide."""
NEIGHBOURS = 12
"""Points of the seam whose tangent planes count for a vertex, by the inverse fourth power of their distance."""
LASHES = "lash/eyelashes02"
"""Upper and lower lashes of every head: even, of middle length."""
LASH = np.array([0.0143, 0.0092, 0.0077], np.float32)
"""Diffuse albedo of lashes, linear RGB."""

BROWS = "brow_cards"
"""Name of the brows' mesh."""


@dataclass(frozen=True)
class Brows:
    """Brows of one photo.

    Attributes:
        shape: the item that agrees best with them, "brow/eyebrow001".
        colour: (3,) float32 linear RGB of their dark pixels, in the photo's light.
    """

    shape: str
    colour: Float32


def find_brows(photo: Photo, head: HeadModel, fit: Fit, reading: Reading | None) -> Brows | None:
    """Shape and colour of the brows; None where hardly any are seen, or for a head that they were not made for."""
    items = read_items()
    if reading is None or not fits(items, head):
        return None
    shown = reading.parts[..., BROW]
    # Probability of brows from which on a cell gives their colour.
    own = bytes_to_linear(reading.region.cut(photo.pixels, PART_CELLS))[shown > 0.45]
    # Fewest such cells.
    if len(own) < 12:
        return None
    dark = own[own.sum(1) <= np.median(own.sum(1))]
    moved = fit.vertices - items.fitted_head
    overlaps = [(_overlap(shown > 0.5, items.items[name], moved, fit, reading), name) for name in items.names("brow")]
    return Brows(max(overlaps)[1], np.asarray(np.median(dark, 0), np.float32))


UNSEEN, USUAL_BROW = 0.8, "brow/eyebrow012"
"""Share of both brows with more of which hidden they are made up, and their shape."""
DARKER = 0.5
"""Linear colour of brows over that of the hair of the head."""


def hides_brows(chart: Chart, confidence: UInt8) -> bool:
    """Whether a photo shows next to nothing of both brows: the completed skin has none of their hairs.

    ``confidence`` (H, W) is that of the texture on the chart, 0 where nothing is seen. False for a head that brows were
    not made for.
    """
    place = brow_plane(chart)
    return fits(read_items(), chart.head) and bool(place[confidence == 0].sum() > UNSEEN * place.sum())


def made_up_brows(hair: Float32) -> Brows:
    """The usual brows beside hair of a linear RGB (3,) in the photo's light."""
    return Brows(USUAL_BROW, np.asarray(DARKER * hair, np.float32))


def _overlap(shown: Bool, item: Item, moved: Float32, fit: Fit, reading: Reading) -> float:
    """Intersection over union of an item's opaque texels and a mask (PART_CELLS, PART_CELLS) of the narrow crop."""
    points = item.worn(moved)
    flat = reading.region.to_crop(fit.camera.project(points), PART_CELLS)
    found = fragments(flat, fit.camera.to_camera(points)[:, 2], item.triangles, PART_CELLS, PART_CELLS)
    uv = interpolate(item.uv, item.triangles[found.triangle], found.barycentric)
    mask = np.zeros(PART_CELLS**2, bool)
    mask[found.pixel[sample_chart(item.picture, uv)[:, -1] > 127]] = True
    union = int((mask | shown.ravel()).sum())
    return float((mask & shown.ravel()).sum()) / union if union else 0.0


def worn(head: HeadModel, fit: Fit, texture: UInt8, brows: Brows | None) -> tuple[MeshPart, ...]:
    """Meshes beside the head's own and its hair, in the photo's light; none for a head that they were not made for.

    The texture is (h, w, 3) uint8 sRGB on the chart, in the photo's light. Without ``brows`` there are none as cards.
    """
    parts = (
        bust_part(head, fit, texture),
        None if brows is None else brow_part(brows, head, fit),
        lash_part(head, fit),
    )
    return tuple(part for part in parts if part is not None)


def in_albedo(
    parts: tuple[MeshPart, ...], brows: Brows | None, head: HeadModel, albedo: UInt8, light: Float32
) -> tuple[MeshPart, ...]:
    """The meshes of :func:`worn`, with its brows, without the photo's light; all others as they are.

    ``albedo`` (h, w, 3) uint8 sRGB is the skin's; ``light`` (3,) the factors to it, :func:`to_albedo`.
    """
    items = read_items().items
    unlit = []
    for part in parts:
        picture = None
        if part.name == "bust":
            picture = bust_picture(items[BUST], head, albedo)
        elif part.name == BROWS and brows is not None:
            picture = brow_picture(items[brows.shape], natural(brows.colour * light))
        if picture is not None:
            name = part.material.name
            part = replace(part, material=replace(part.material, colour_map=OwnMap(name, picture)))
        unlit.append(part)
    return tuple(unlit)


def lash_part(head: HeadModel, fit: Fit) -> MeshPart | None:
    """Upper and lower lashes, which follow the lids; None for a head that they were not made for."""
    items = read_items()
    if not fits(items, head):
        return None
    colour = np.rint(255 * linear_to_srgb(LASH)).astype(np.uint8)
    # Factor on the asset's alpha, half of which is covered: 120 lashes of 0.07 mm, which taper, cover a quarter of a
    # lid's 30 mm (Thibaut et al. 2010). Denser ones shade the eye in path tracers.
    alpha = np.rint(0.5 * items.items[LASHES].picture[..., 0]).astype(np.uint8)
    material = Material(
        "lashes", colour_map=OwnMap("lashes", _in_colour(alpha, colour)), alpha="blend", double_sided=True,
        roughness=0.6,
    )  # fmt: skip
    return _following("lash_cards", items.items[LASHES], items, head, fit, material, replaces=("lashes",))


def _in_colour(alpha: UInt8, colour: UInt8) -> UInt8:
    """(h, w, 4) one sRGB colour (3,) with an alpha (h, w)."""
    flat = np.broadcast_to(colour, (*alpha.shape, 3))
    return np.ascontiguousarray(np.concatenate([flat, alpha[..., None]], 2))


def _following(
    name: str, item: Item, items: Items, head: HeadModel, fit: Fit, material: Material, **more: Any
) -> MeshPart:
    """An item that follows the head."""
    return following(
        name, head, fit, items.fitted_head, item.rest, item.moved, item.triangles, item.uv, material, **more
    )


def brow_part(brows: Brows, head: HeadModel, fit: Fit) -> MeshPart:
    """Brows over those of the skin, in the shape that agrees best with the photo's."""
    items = read_items()
    item = items.items[brows.shape]
    picture = brow_picture(item, brows.colour)
    material = Material("brows", colour_map=OwnMap("brows", picture), alpha="blend", double_sided=True, roughness=0.6)
    normals = area_normals(item.worn(fit.neutral - items.fitted_head), item.triangles)
    # Height of the brows' cards over where they were made: the skin of another head is curved differently.
    return _following(BROWS, item, items, head, fit, material, lift=0.0004 * normals)


def brow_picture(item: Item, colour: Float32) -> UInt8:
    """(h, w, 4) uint8 of brows of one linear RGB colour (3,)."""
    coded = linear_to_srgb(np.clip(colour, 0, 0.6).astype(np.float32))
    return _in_colour(item.picture[..., 0], np.rint(255 * coded).astype(np.uint8))


def bust_colours(head: HeadModel, chart_colours: UInt8) -> UInt8 | None:
    """:func:`bust_picture` of a head; None for one that the bust was not made for."""
    items = read_items()
    return bust_picture(items.items[BUST], head, chart_colours) if fits(items, head) else None


def bust_part(head: HeadModel, fit: Fit, chart_colours: UInt8) -> MeshPart | None:
    """Neck and shoulders below the head; None for a head that they were not made for.

    Their colours are taken from the chart's (h, w, 3), uint8 sRGB, albedo or texture.
    """
    items, picture = read_items(), bust_colours(head, chart_colours)
    if picture is None:
        return None
    item, drawn = items.items[BUST], OwnMap("bust", picture)
    material = Material(
        "bust", colour_map=drawn, roughness=BUST_ROUGHNESS, specular=SKIN.specular, subsurface_mm=SKIN.subsurface_mm
    )
    return _tangent(_following("bust", item, items, head, fit, material), item, head, fit)


def _tangent(part: MeshPart, item: Item, head: HeadModel, fit: Fit) -> MeshPart:
    """The bust leaving the neck in its tangent planes: shading goes on over the seam, of which each mesh has one side.

    Its triangles are split first, else one step would take the whole turn, and their corners rounded off.
    """
    at, of = seam(item)
    if not len(at):
        return part
    names = list(part.targets)
    moves = [part.targets[name] for name in names]
    on_seam = np.zeros((len(part.neutral), 1))
    on_seam[at] = 1.0
    columns = np.concatenate([part.neutral, part.vertices, part.uv, *moves, on_seam], 1).astype(np.float64)
    triangles = part.faces.astype(np.int64)
    rim, normals = fit.neutral[of].astype(np.float64), area_normals(fit.neutral, head.triangles)[of].astype(np.float64)
    tree = Nearest(rim)
    for _ in range(SPLITS):
        columns, triangles = split_in_four(columns, triangles, np.ones(len(triangles), bool))
    _round_off(columns[:, :6], triangles, ROUNDS)
    for rounds in (ROUNDS // 4, 1, 0):
        away, which = tree(columns[:, :3], NEIGHBOURS)
        share = 1 / (away + 1e-6) ** 4
        share /= share.sum(1, keepdims=True)
        height = np.einsum("nki,nki->nk", columns[:, None, :3] - rim[which], normals[which])
        back = -np.einsum("nk,nk,nki->ni", share, height, normals[which])
        # Distance from the seam up to which the bust bends towards the neck's tangent planes.
        fading = np.clip(1 - away[:, :1] / 0.045, 0, 1) ** 2
        # On the seam the two meshes share straight edges.
        columns[:, :6] += np.tile(fading * back * (columns[:, -1:] < 1), 2)
        _round_off(columns[:, :6], triangles, rounds)
    # What is left of the turn at the seam, where each mesh knows its own side alone, fades away over the bust.
    own = area_normals(columns[:, :3], triangles)
    turn = np.einsum("nk,nki->ni", share, (normals - own[at])[which])
    f = np.float32
    return replace(
        part,
        normals=unit(own + (fading * turn).astype(f)),
        neutral=columns[:, :3].astype(f),
        vertices=columns[:, 3:6].astype(f),
        uv=columns[:, 6:8].astype(f),
        faces=triangles.astype(np.int32),
        targets={name: columns[:, 8 + 3 * k : 11 + 3 * k].astype(f) for k, name in enumerate(names)},
    )


def _round_off(columns: Float64, triangles: Int64, rounds: int) -> None:
    """Move each vertex (N, C) towards the mean of its neighbours, so many times; open borders stay."""
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, 1)], 2).reshape(-1, 2), 1)
    edges, count = np.unique(sides[:, 0] * len(columns) + sides[:, 1], return_counts=True)
    pull = laplacian(triangles, len(columns))
    step = 0.5 / np.maximum(pull.diagonal(), 1)[:, None]
    step[np.concatenate(np.divmod(edges[count == 1], len(columns)))] = 0.0
    for _ in range(rounds):
        columns -= step * (pull @ columns)


def seam(item: Item) -> tuple[Int64, Int64]:
    """Vertices of the bust that are the head's own, and which those are."""
    # Weight of one vertex of the head from which on a vertex of the bust is the same point.
    own = np.flatnonzero(item.share[:, 0] > 0.99)
    return own, item.follow[own, 0].astype(np.int64)


def _colours(item: Item, head: HeadModel, chart_colours: UInt8) -> Float32:
    """(N, 3) linear RGB: the neck's at the seam, and from there on ever more its mean."""
    on_chart = np.zeros(len(head.mean), np.int64)
    on_chart[head.triangles] = head.triangle_uv
    linear = bytes_to_linear(np.rint(sample_chart(chart_colours, head.uv[on_chart])).astype(np.uint8))
    neck = vertex_mask(head, "neck") > 0.5
    usual = np.median(linear[neck], 0) if neck.any() else np.median(linear, 0)
    (at, of), count = seam(item), len(item.rest)
    known, trust = np.zeros((count, 3)), np.zeros(count)
    known[at], trust[at] = linear[of], 1e3  # on the seam no step may be seen
    edges = laplacian(item.triangles, count)
    return np.asarray(smooth_fit(edges, known, trust, 0.05, usual.astype(np.float64), 0.002), np.float32)


def bust_picture(item: Item, head: HeadModel, chart_colours: UInt8) -> UInt8:
    """(SIDE, SIDE, 3) uint8 sRGB, extended beyond the islands; arguments as :func:`bust_part` has them."""
    colours = _colours(item, head, chart_colours)
    at: Float64 = np.stack([item.uv[:, 0], 1 - item.uv[:, 1]], 1).astype(np.float64) * SIDE
    drawn = rasterise(at, np.zeros(len(at)), item.triangles, SIDE, SIDE)
    shown = np.flatnonzero(drawn.mask)
    out = np.zeros((SIDE * SIDE, 3), np.float32)
    corners = item.triangles[drawn.triangle.ravel()[shown]]
    out[shown] = interpolate(colours, corners, drawn.barycentric.reshape(-1, 3)[shown])
    return np.rint(255 * np.clip(linear_to_srgb(out[nearest_inside(drawn.mask)]), 0, 1)).astype(np.uint8)


def to_albedo(texture: UInt8, albedo: UInt8, lit_skin: UInt8) -> Float32:
    """(3,) median ratio of linear albedo to linear texture, both (h, w, 3) uint8, over lit skin (h, w); 1 without any.

    The light on hair is that on the skin: the networks say what it is there.
    """
    # Code of the lit skin's map from which on a texel tells what the photo's light is.
    chosen = lit_skin >= 200
    # Fewest such texels.
    if int(chosen.sum()) < 100:
        return np.ones(3, np.float32)
    shown, own = (bytes_to_linear(image[chosen]) for image in (texture, albedo))
    ratio = np.median(own / np.maximum(shown, np.float32(1e-3)), 0)
    # Smallest and largest ratio of albedo to the photo's colour in a channel.
    return np.asarray(np.clip(ratio, 0.2, 4.0), np.float32)


def small_albedo(codes: UInt16, size: tuple[int, int]) -> UInt8:
    """(h, w, 3) uint8 sRGB, ``size`` = (w, h), of 16-bit codes of diffuse albedo (H, W, 3)."""
    small = np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), np.float32)
    return np.rint(small / 257).astype(np.uint8)
