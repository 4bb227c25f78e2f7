"""What the files of meshes are made from: normals, vertices split at the cuts of a texture, the head subdivided and
displaced, and a skeleton: neck, head, jaw and eyes, with the weights by which the skin follows.

Expressions are blendshapes; the joints are for what blendshapes cannot do, turning, and as an alternative for the jaw.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, Int64, UInt16
from service.geometry.chart import any_orthogonal, solve_affine
from service.geometry.mesh import area_normals, face_normals, normalise, summed
from service.geometry.raster import signed_area
from service.geometry.remesh import Subdivision
from service.head.files import split_polygons, triangle_fields
from service.head.model import HeadModel
from service.head.regions import part_vertices, vertex_mask
from service.image_filters import shrunk
from service.materials.part import MeshPart, part_normals
from service.reflectance.reflectance_maps import MID, SCALE_MM

SMALLEST_OFFSET_M = 2.5e-5
"""Shorter position offsets of a blendshape are written as 0, or left out."""
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

    def offsets(self, units: Sequence[str]) -> Iterator[tuple[Float32, Float32]]:
        """(N, 3) offsets of position and of normal of each unit, zero where they are negligible."""
        moved, turned = self.part.targets, self.part.turned
        none = np.zeros((len(self.vertex), 3), np.float32)
        for unit in units:
            if unit in moved:
                yield _cut(moved[unit], SMALLEST_OFFSET_M)[self.vertex], _cut(turned[unit], SMALLEST_TURN)[self.vertex]
            else:
                yield none, none

    def tangents(self) -> Float32:
        """(N, 4) unit tangents along u, orthogonal to the normals, and the handedness: normal x tangent is its v."""
        points, corner = self.part.neutral[self.vertex].astype(np.float64), self.triangles.ravel()
        du, _ = solve_affine(self.uv.astype(np.float64)[self.triangles], points[self.triangles])
        area = signed_area(self.uv, self.triangles)
        along = summed(corner, np.repeat(du * np.abs(area)[:, None], 3, 0), len(points))
        along = normalise(along, (0.0, 0.0, 0.0))
        flat = along.astype(np.float32) - self.normal * np.einsum("ni,ni->n", along, self.normal)[:, None]
        # Where the direction of u is degenerate (a pole, a sliver) the tangent is arbitrary.
        degenerate = np.einsum("ni,ni->n", flat, flat) < 1e-6
        flat[degenerate] = any_orthogonal(self.normal[degenerate])
        unit = flat / np.sqrt(np.einsum("ni,ni->n", flat, flat))[:, None]
        mirrored = summed(corner, np.repeat(area, 3)[:, None], len(points)) < 0
        return np.concatenate([unit, np.where(mirrored, -1, 1)], 1).astype(np.float32)


def _cut(offsets: Float32, least: float) -> Float32:
    """(V, 3) offsets with rows shorter than ``least`` set to zero."""
    small = np.einsum("vc,vc->v", offsets, offsets) < least * least
    return np.where(small[..., None], np.float32(0), offsets)


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
        **triangle_fields(quads, quads_uv, part),
    )
    return fine, points


def displaced(head: HeadModel, vertices: Float64, displacement: UInt16) -> Float64:
    """(V, 3) vertices displaced along their normals by a map (H, W); by less where that would turn a triangle over.

    Vertices on a cut of the chart take the mean height of both sides, so that the mesh stays closed.
    """
    height = heights_at(head, displacement) * 1e-3
    normals = area_normals(vertices, head.triangles).astype(np.float64)
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
    from scipy.ndimage import map_coordinates

    relief = displacement.astype(np.float32)
    if relief.shape[1] > RELIEF_WIDTH:
        size = (RELIEF_WIDTH, RELIEF_WIDTH * relief.shape[0] // relief.shape[1])
        relief = shrunk(relief, size)
    u, v = head.uv.astype(np.float64).T
    at = np.stack([(1 - v) * relief.shape[0], u * relief.shape[1]]) - 0.5
    sampled = map_coordinates(relief, at, np.float64, order=1, mode="nearest")
    corner, corner_uv = head.polygons.ravel(), head.polygon_uv.ravel()
    pairs = np.unique(corner.astype(np.int64) * len(head.uv) + corner_uv)
    vertex, place = pairs // len(head.uv), pairs % len(head.uv)
    count = np.bincount(vertex, minlength=len(head.mean))
    total = np.bincount(vertex, sampled[place], len(head.mean))
    mean = np.where(count > 0, total / np.maximum(count, 1), MID)
    return np.asarray((mean - MID) * SCALE_MM)


JOINTS = ("neck", "head", "jaw", "eye_left", "eye_right")
PARENTS = (-1, 0, 1, 1, 1)
"""Index of each joint's parent; -1 is none."""

_NECK, _HEAD, _JAW = 0, 1, 2

EAR_TO_JOINT_M = 0.012
"""The head turns on the neck about as far below the middle of the ears."""

JAW_TURN_DEG = 16.0
"""Turn of the jaw at jawOpen where the head has no lower teeth to measure it by."""


@dataclass(frozen=True)
class Skeleton:
    """Joints in metres, head space, their axes those of the head.

    Attributes:
        positions: (5, 3) float64, in the order of ``JOINTS``.
        weights: (V, 5) float32 by which each vertex of the head follows each joint, summing to 1.
    """

    positions: Float64
    weights: Float32


def skeleton(head: HeadModel, neutral: AnyFloat) -> Skeleton:
    """The skeleton of a neutral head (V, 3) metres, by its parts, regions and blendshapes."""
    points = np.asarray(neutral, np.float64)
    low, high = points.min(0), points.max(0)
    base = points[points[:, 1] < low[1] + 0.02 * (high[1] - low[1])].mean(0)
    ears = vertex_mask(head, "ear_left", "ear_right") > 0.5
    middle = points[ears].mean(0) if ears.any() else (low + high) / 2
    turning = np.array([0.0, middle[1] - EAR_TO_JOINT_M, middle[2]])
    jaw, share = _jaw(head, points, turning)
    eyes = [_centre(points[part_vertices(head, name)], turning) for name in ("eye_left", "eye_right")]
    positions = np.stack([base * [0, 1, 1], turning, jaw, *eyes])
    return Skeleton(positions, _weights(head, points, positions, share))


def joint_weights(head: HeadModel, joints: Skeleton) -> dict[str, Float32]:
    """(N, 5) weights of each of the head's own parts, in the order of ``service.materials.part.head_parts``."""
    found = {}
    for index, name in enumerate(head.part_names):
        polygons = head.polygons[head.polygon_part == index]
        if len(polygons):
            found[name] = joints.weights[np.unique(polygons[polygons >= 0])]
    return found


def _centre(ball: Float64, otherwise: Float64) -> Float64:
    """Middle of a ball's bounding box, as its vertices are denser in front."""
    return np.asarray((ball.min(0) + ball.max(0)) / 2) if len(ball) else otherwise


def _jaw(head: HeadModel, points: Float64, turning: Float64) -> tuple[Float64, Float64]:
    """Position of the jaw's joint, and (V,) share of each vertex in its turn.

    ``jawOpen`` moves the lower teeth rigidly; the joint lies where that turn about +X has its axis, and the share of
    the skin is how far it goes of the way that the turn would take it.
    """
    moved = np.zeros_like(points)
    if "jawOpen" in head.expression_names:
        moved = head.expression[head.expression_names.index("jawOpen")].astype(np.float64)
    teeth = part_vertices(head, "teeth_lower")
    pivot, angle = turning + np.array([0, -0.005, 0.02]), np.radians(JAW_TURN_DEG)
    if len(teeth) > 2 and np.abs(moved[teeth]).max() > 1e-4:
        pivot, angle = _turn(points[teeth], points[teeth] + moved[teeth], pivot, angle)
    y, z = points[:, 1] - pivot[1], points[:, 2] - pivot[2]
    way = np.stack([np.zeros_like(y), y * (np.cos(angle) - 1) - z * np.sin(angle),
                    y * np.sin(angle) + z * (np.cos(angle) - 1)], 1)  # fmt: skip
    along = np.einsum("vi,vi->v", moved, normalise(way, (0.0, 0.0, 0.0)))
    return pivot, np.clip(along / np.maximum(np.linalg.norm(way, axis=1), 1e-3), 0, 1)


def _turn(before: Float64, after: Float64, pivot: Float64, angle: float) -> tuple[Float64, float]:
    """Axis point and angle of the turn about +X that takes points (N, 3) to others, by least squares in the y-z plane.

    What is hardly a turn leaves ``pivot`` and ``angle`` as they are.
    """
    a, b = before[:, 1:], after[:, 1:]
    p, q = a - a.mean(0), b - b.mean(0)
    found = float(np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()))
    if abs(found) < np.radians(2):
        return pivot, angle
    turn = np.array([[np.cos(found), -np.sin(found)], [np.sin(found), np.cos(found)]])
    fixed = np.linalg.solve(np.eye(2) - turn, b.mean(0) - turn @ a.mean(0))
    if np.linalg.norm(fixed - pivot[1:]) > 0.06:
        return pivot, found  # a jaw that slides as it opens; its axis is not in the head
    return np.array([0.0, *fixed]), found


def _weights(head: HeadModel, points: Float64, positions: Float64, share: Float64) -> Float32:
    weights = np.zeros((len(points), len(JOINTS)), np.float32)
    below = (positions[_HEAD, 1] - points[:, 1]) / max(positions[_HEAD, 1] - positions[_NECK, 1], 1e-6)
    neck = vertex_mask(head, "neck") * np.clip(below, 0, 1)
    weights[:, _NECK] = neck
    weights[:, _JAW] = (1 - neck) * share
    for index, name in enumerate(head.part_names):
        own = np.unique(head.triangles[head.triangle_part == index])
        joint = {"eye_left": 3, "eye_right": 4, "teeth_lower": _JAW, "tongue": _JAW}.get(name)
        if joint is not None:
            weights[own] = np.eye(len(JOINTS), dtype=np.float32)[joint]
        elif index:
            weights[own] = 0  # with the head
    weights[:, _HEAD] += 1 - weights.sum(1)
    return np.asarray(np.clip(weights, 0, 1), np.float32)
