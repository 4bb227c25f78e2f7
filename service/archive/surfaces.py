"""Surfaces of the meshes: normals, vertices split at the cuts of a texture, the head subdivided and displaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, Int32, Int64, UInt16
from service.geometry.chart import any_orthogonal, solve_affine
from service.geometry.mesh import area_normals, face_normals, normalise
from service.geometry.remesh import Subdivision
from service.head.files import split_polygons
from service.head.model import HeadModel
from service.materials.part import MeshPart, part_normals
from service.reflectance.reflectance_maps import MID, SCALE_MM

vertex_normals = area_normals
"""The normals of all meshes in the archive but masked cards."""
SMALLEST_OFFSET_M = 2.5e-5
"""Shorter position offsets of a blendshape are written as 0."""
SMALLEST_TURN = 0.03
"""Shorter normal offsets of a blendshape are written as 0: under two degrees."""


@dataclass(frozen=True)
class Piece:
    """A part with vertices split at the cuts of its texture.

    Attributes:
        part: what it was.
        vertex: (N,) int64 vertex of the part at each split vertex.
        uv: (N, 2) float32, origin bottom left.
        triangles: (M, 3) int64 indices below N, counter-clockwise from outside.
        normal: (N, 3) float32 unit.
    """

    part: MeshPart
    vertex: Int64
    uv: Float32
    triangles: Int64
    normal: Float32

    @classmethod
    def of(cls, part: MeshPart) -> Piece:
        """Split a part; N is as small as the cuts allow."""
        corners, places = split_polygons(part.polygons), split_polygons(part.polygons_uv)
        pairs, local = np.unique(corners.astype(np.int64) * len(part.uv) + places, return_inverse=True)
        vertex, place = pairs // len(part.uv), pairs % len(part.uv)
        normal = part_normals(part, part.neutral, corners)
        return cls(part, vertex, part.uv[place], local.reshape(-1, 3), normal[vertex])

    def offsets(self, units: Sequence[str]) -> tuple[Float32, Float32]:
        """(E, N, 3) offsets of position and of normal of each unit, zero where they are negligible."""
        part, corners = self.part, split_polygons(self.part.polygons)
        position = np.zeros((len(units), len(part.neutral), 3), np.float32)
        turned = np.zeros_like(position)
        moving = [number for number, unit in enumerate(units) if unit in part.targets]
        if moving:
            moved = np.stack([part.targets[units[number]] for number in moving]).astype(np.float32)
            still = part_normals(part, part.neutral, corners)
            position[moving] = _cut(moved, SMALLEST_OFFSET_M)
            turned[moving] = _cut(part_normals(part, part.neutral + moved, corners) - still, SMALLEST_TURN)
        return position[:, self.vertex], turned[:, self.vertex]

    def tangents(self) -> Float32:
        """(N, 4) unit tangents along u, orthogonal to the normals, and the handedness: normal x tangent is its v."""
        uv, points = self.uv.astype(np.float64)[self.triangles], self.part.neutral[self.vertex].astype(np.float64)
        du, _ = solve_affine(uv, points[self.triangles])
        d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
        along = normalise(_sum(self.triangles, du * np.abs(area)[:, None], len(points)), (0.0, 0.0, 0.0))
        flat = along.astype(np.float32) - self.normal * np.einsum("ni,ni->n", along, self.normal)[:, None]
        # Where the direction of u is degenerate (a pole, a sliver) the tangent is arbitrary.
        degenerate = np.einsum("ni,ni->n", flat, flat) < 1e-6
        flat[degenerate] = any_orthogonal(self.normal[degenerate])
        unit = flat / np.sqrt(np.einsum("ni,ni->n", flat, flat))[:, None]
        mirrored = _sum(self.triangles, area[:, None], len(points)) < 0
        return np.concatenate([unit, np.where(mirrored, -1, 1)], 1).astype(np.float32)


def _cut(offsets: Float32, least: float) -> Float32:
    """Offsets with rows shorter than ``least`` set to zero."""
    small = np.einsum("evc,evc->ev", offsets, offsets) < least * least
    return np.where(small[..., None], np.float32(0), offsets)


def _sum(triangles: Int32 | Int64, values: Float64, count: int) -> Float64:
    """(count, C) sums over the corners of triangles (M, 3) of their values (M, C)."""
    index = triangles.ravel()
    return np.stack([np.bincount(index, np.repeat(column, 3), count) for column in values.T], 1)


STEPS = 3
"""Subdivision steps: every quad becomes 64, with edges of about half a millimetre."""

RELIEF_WIDTH = 1536
"""Width to which the displacement map is reduced first, as finer relief would alias on the mesh."""

MOST_HALVINGS = 6
"""Most halvings of a displacement that turns a triangle over; the last sets it to 0."""


def subdivided_head(head: HeadModel, vertices: AnyFloat, steps: int = STEPS) -> tuple[HeadModel, Float64]:
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
