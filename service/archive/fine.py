"""``mesh/head_fine.obj``: the head subdivided, with the displacement map embossed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.archive.obj import obj_bytes
from service.archive.surface import vertex_normals
from service.arrays import AnyFloat, Float32, Float64, UInt16
from service.geometry.normals import face_normals
from service.geometry.subdivide import Subdivision
from service.head.files import split_polygons
from service.head.model import HeadModel
from service.reflectance.result import MID, SCALE_MM

STEPS = 3
"""Every quad becomes 64: edges of about half a millimetre."""

RELIEF_WIDTH = 1536
"""The map is averaged to this width first: finer relief would alias on a mesh of that size."""

MOST_HALVINGS = 6


def fine_obj_bytes(head: HeadModel, vertices: AnyFloat, displacement: UInt16, title: str) -> bytes:
    """OBJ text of the subdivided, displaced head.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres.
        displacement: (H, W) codes of heights.
        title: first line of the file.
    """
    fine, smooth = subdivided(head, vertices)
    return obj_bytes(fine, embossed(fine, smooth, displacement), f"{title}, subdivided and displaced")


def subdivided(head: HeadModel, vertices: AnyFloat, steps: int = STEPS) -> tuple[HeadModel, Float64]:
    """A head model of quads with the finer topology and chart (its other fields are meaningless), and its vertices."""
    points, uv = np.asarray(vertices, np.float64), np.asarray(head.uv, np.float64)
    polygons, polygons_uv, part = head.polygons.astype(np.int64), head.polygon_uv.astype(np.int64), head.polygon_part
    for _ in range(steps):
        step, step_uv = Subdivision.of(polygons, len(points)), Subdivision.of(polygons_uv, len(uv))
        points, uv = step.smooth(points), step_uv.linear(uv)
        polygons, polygons_uv, part = step.quads, step_uv.quads, part[step.owner]
    quads, quads_uv = polygons.astype(np.int32), polygons_uv.astype(np.int32)
    fine = replace(
        head,
        mean=points.astype(np.float32),
        polygons=quads,
        polygon_uv=quads_uv,
        polygon_part=part,
        uv=uv.astype(np.float32),
        triangles=split_polygons(quads),
        triangle_uv=split_polygons(quads_uv),
        triangle_part=np.concatenate([part, part]),
    )
    return fine, points


def embossed(head: HeadModel, vertices: Float64, displacement: UInt16) -> Float64:
    """(V, 3) vertices moved along their normals by a map (H, W); where that would turn a triangle over, by less.

    Vertices on a cut of the chart take the mean of what both sides say, so that the mesh stays closed.
    """
    height = heights_at(head, displacement) * 1e-3
    normals = vertex_normals(vertices, head.triangles).astype(np.float64)
    before = face_normals(vertices, head.triangles)
    for halving in range(MOST_HALVINGS + 1):
        moved = vertices + height[:, None] * normals
        turned = np.einsum("ti,ti->t", face_normals(moved, head.triangles), before) < 0
        if not turned.any():
            break
        height[head.triangles[turned]] *= 0.5 if halving < MOST_HALVINGS - 1 else 0.0
    return moved


def heights_at(head: HeadModel, displacement: UInt16) -> Float64:
    """(V,) height in mm of each vertex of a head of quads: the mean over its places on the chart."""
    import cv2

    relief = displacement.astype(np.float32)
    if relief.shape[1] > RELIEF_WIDTH:
        size = (RELIEF_WIDTH, RELIEF_WIDTH * relief.shape[0] // relief.shape[1])
        relief = np.asarray(cv2.resize(relief, size, interpolation=cv2.INTER_AREA))
    sampled = _bilinear(relief, head.uv.astype(np.float64))
    corner, corner_uv = head.polygons.ravel(), head.polygon_uv.ravel()
    pairs = np.unique(corner.astype(np.int64) * len(head.uv) + corner_uv)
    vertex, place = pairs // len(head.uv), pairs % len(head.uv)
    count = np.bincount(vertex, minlength=len(head.mean))
    total = np.bincount(vertex, sampled[place], len(head.mean))
    mean = np.where(count > 0, total / np.maximum(count, 1), MID)
    return np.asarray((mean - MID) * SCALE_MM)


def _bilinear(image: Float32, uv: Float64) -> Float64:
    """(N,) values of an (H, W) map at chart coordinates (N, 2), origin bottom left."""
    tall, wide = image.shape
    x = np.clip(uv[:, 0] * wide - 0.5, 0, wide - 1)
    y = np.clip((1 - uv[:, 1]) * tall - 0.5, 0, tall - 1)
    left, top = np.minimum(x.astype(int), max(wide - 2, 0)), np.minimum(y.astype(int), max(tall - 2, 0))
    right, bottom = np.minimum(left + 1, wide - 1), np.minimum(top + 1, tall - 1)
    across, down = x - left, y - top
    upper = image[top, left] * (1 - across) + image[top, right] * across
    lower = image[bottom, left] * (1 - across) + image[bottom, right] * across
    return np.asarray(upper * (1 - down) + lower * down)
