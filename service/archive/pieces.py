"""Meshes with one index per vertex, as glTF wants them: vertices split at the cuts of the texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.archive.surface import part_normals
from service.arrays import Float32, Float64, Int32, Int64
from service.geometry.chart import any_orthogonal, solve_affine
from service.geometry.normals import normalise
from service.head.files import split_polygons
from service.materials.part import MeshPart

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
