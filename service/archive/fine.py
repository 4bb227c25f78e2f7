"""``mesh/head_fine.obj``: the head subdivided and displaced."""

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
from service.reflectance.reflectance_maps import MID, SCALE_MM

STEPS = 3
"""Subdivision steps: every quad becomes 64, with edges of about half a millimetre."""

RELIEF_WIDTH = 1536
"""Width to which the displacement map is reduced first, as finer relief would alias on the mesh."""

MOST_HALVINGS = 6
"""Most halvings of a displacement that turns a triangle over; the last sets it to 0."""


def fine_obj_bytes(head: HeadModel, vertices: AnyFloat, displacement: UInt16, title: str) -> bytes:
    """OBJ text of the subdivided, displaced head.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres.
        displacement: (H, W) uint16 codes of heights.
        title: first line of the file.
    """
    fine, smooth = subdivided(head, vertices)
    return obj_bytes(fine, displaced(fine, smooth, displacement), f"{title}, subdivided and displaced")


def subdivided(head: HeadModel, vertices: AnyFloat, steps: int = STEPS) -> tuple[HeadModel, Float64]:
    """A head model of quads with the finer topology and chart (its other fields are not valid), and its vertices."""
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


def displaced(head: HeadModel, vertices: Float64, displacement: UInt16) -> Float64:
    """(V, 3) vertices displaced along their normals by a map (H, W); by less where that would turn a triangle over.

    Vertices on a cut of the chart take the mean height of both sides, so that the mesh stays closed.
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
    """(V,) height in mm of each vertex of a head of quads: mean over its chart vertices."""
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
    height, width = image.shape
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - uv[:, 1]) * height - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = x - left, y - top
    upper = image[top, left] * (1 - across) + image[top, right] * across
    lower = image[bottom, left] * (1 - across) + image[bottom, right] * across
    return np.asarray(upper * (1 - down) + lower * down)
