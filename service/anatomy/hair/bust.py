"""The bust: shoulders that go on from the head's neck, in the neck's own colour."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from service.anatomy.hair.item import Item, read_items
from service.anatomy.hair.parts import following
from service.anatomy.hair.skull import fits
from service.arrays import Float32, Float64, Int64, UInt8
from service.colour import bytes_to_linear, linear_to_srgb
from service.face.fit.result import Fit
from service.geometry.cutting import split
from service.geometry.mesh_field import laplacian, smooth_fit
from service.geometry.normals import area_normals
from service.geometry.raster import interpolate, rasterise
from service.geometry.sampling import sample_chart
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.materials.material import Material, OwnMap
from service.materials.of_head import SKIN
from service.materials.part import MeshPart

BUST = "bust/body"
SIDE = 256
"""Texels along its texture, which holds a smooth colour only."""
EXACT = 0.99
"""Weight of one vertex of the head from which on a vertex of the bust is the same point."""
ROUGHNESS = 0.55
BLEND_M = 0.045
"""Distance from the seam up to which the bust bends towards the neck's tangent planes."""
SPLITS = 2
NEIGHBOURS = 12
"""Points of the seam whose tangent planes count for a vertex, by the inverse fourth power of their distance."""


def bust_part(head: HeadModel, fit: Fit, chart_colours: UInt8) -> MeshPart | None:
    """Neck and shoulders below the head; None for a head that they were not made for.

    Args:
        head: topology, chart and units.
        fit: vertices of the head.
        chart_colours: (h, w, 3) uint8 sRGB on the chart, albedo or texture.
    """
    items = read_items()
    if not fits(items, head):
        return None
    item = items.items[BUST]
    picture = OwnMap("bust", _picture(item, _colours(item, head, chart_colours)))
    material = Material(
        "bust", colour_map=picture, roughness=ROUGHNESS, specular=SKIN.specular, subsurface_mm=SKIN.subsurface_mm
    )
    return _tangent(following("bust", item, items, head, fit, material), item, head, fit)


def _tangent(part: MeshPart, item: Item, head: HeadModel, fit: Fit) -> MeshPart:
    """The bust leaving the neck in its tangent planes: shading goes on over the seam, of which each mesh has one side.

    Its triangles are split first, else one step would take the whole turn.
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
    tree = cKDTree(rim)
    for _ in range(SPLITS):
        columns, triangles = split(columns, triangles, np.ones(len(triangles), bool))
    away, which = tree.query(columns[:, :3], min(NEIGHBOURS, len(rim)))
    away, which = away.reshape(len(columns), -1), which.reshape(len(columns), -1)
    share = 1 / (away + 1e-6) ** 4
    share /= share.sum(1, keepdims=True)
    height = np.einsum("nki,nki->nk", columns[:, None, :3] - rim[which], normals[which])
    back = -np.einsum("nk,nk,nki->ni", share, height, normals[which])
    fading = np.clip(1 - away[:, :1] / BLEND_M, 0, 1) ** 2
    # On the seam the two meshes share straight edges.
    columns[:, :6] += np.tile(fading * back * (columns[:, -1:] < 1), 2)
    f = np.float32
    return replace(
        part,
        neutral=columns[:, :3].astype(f),
        vertices=columns[:, 3:6].astype(f),
        uv=columns[:, 6:8].astype(f),
        faces=triangles.astype(np.int32),
        targets={name: columns[:, 8 + 3 * k : 11 + 3 * k].astype(f) for k, name in enumerate(names)},
    )


def seam(item: Item) -> tuple[Int64, Int64]:
    """Vertices of the bust that are the head's own, and which those are."""
    own = np.flatnonzero(item.share[:, 0] > EXACT)
    return own, item.follow[own, 0].astype(np.int64)


def _colours(item: Item, head: HeadModel, chart_colours: UInt8) -> Float32:
    """(N, 3) linear RGB: the neck's at the seam, and from there on ever more its mean."""
    on_chart = np.zeros(len(head.mean), np.int64)
    on_chart[head.triangles] = head.triangle_uv
    linear = bytes_to_linear(np.rint(sample_chart(chart_colours, head.uv[on_chart])).astype(np.uint8))
    neck = vertex_mask(head, "neck") > 0.5
    usual = np.median(linear[neck], 0) if neck.any() else np.median(linear, 0)
    at, of = seam(item)
    same = _welded(item)
    count = int(same.max()) + 1
    known, trust = np.zeros((count, 3)), np.zeros(count)
    known[same[at]], trust[same[at]] = linear[of], 1.0
    edges = laplacian(same[item.triangles], count)
    return np.asarray(smooth_fit(edges, known, trust, 0.05, usual.astype(np.float64), 0.002)[same], np.float32)


def _welded(item: Item) -> Int64:
    """(N,) index of the point that each vertex is a copy of; copies differ in their place on the texture."""
    rounded = np.round(item.rest * 1e5).astype(np.int64)
    return np.asarray(np.unique(rounded, axis=0, return_inverse=True)[1].ravel(), np.int64)


def _picture(item: Item, colours: Float32) -> UInt8:
    """(SIDE, SIDE, 3) uint8 sRGB, extended beyond the islands."""
    import cv2

    at: Float64 = np.stack([item.uv[:, 0], 1 - item.uv[:, 1]], 1).astype(np.float64) * SIDE
    drawn = rasterise(at, np.zeros(len(at)), item.triangles, SIDE, SIDE)
    shown = np.flatnonzero(drawn.mask)
    out = np.zeros((SIDE * SIDE, 3), np.float32)
    corners = item.triangles[drawn.triangle.ravel()[shown]]
    out[shown] = interpolate(colours, corners, drawn.barycentric.reshape(-1, 3)[shown])
    beside = (~drawn.mask).astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(beside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    source = np.zeros(int(label.max()) + 1, np.int64)
    source[label.ravel()[shown]] = shown
    return np.rint(255 * np.clip(linear_to_srgb(out[source[label.ravel()]]), 0, 1)).astype(np.uint8).reshape(
        SIDE, SIDE, 3
    )
