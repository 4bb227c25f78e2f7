"""Checks that an external mesh has the head model's topology and chart."""

from __future__ import annotations

import numpy as np

from service.archive.read_obj import ObjMesh
from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int64
from service.errors import BadMesh
from service.head.files import split_polygons
from service.head.model import HeadModel

CHART_TOLERANCE = 2e-3
"""Largest difference of texture coordinates, which exporters round; a texel of a chart 576 texels wide is 1.7e-3."""

SMALLEST_M, LARGEST_M = 0.1, 1.0
"""Height of a head with its neck; a mesh in another unit is off by a factor of ten or more."""


def vertices_of(mesh: ObjMesh, head: HeadModel) -> Float32:
    """(V, 3) float32 vertices of a mesh in the order of the head model.

    Faces may come in any order, begin at any corner and be split into triangles; vertices have to be in the model's
    order, as in ``mesh/head.obj`` of every archive.

    Raises:
        BadMesh: number of vertices, faces or chart differ, or it is not in metres; says how.
    """
    if len(mesh.vertices) != len(head.mean):
        raise BadMesh(
            f"the mesh has {len(mesh.vertices)} vertices, the head model {head.name} has {len(head.mean)}; start from "
            "mesh/head.obj of an archive, and move vertices without adding, removing or merging any",
            vertices=len(mesh.vertices), wanted=len(head.mean),
        )  # fmt: skip
    _check_faces(mesh, head)
    _check_chart(mesh, head)
    height = float(np.ptp(mesh.vertices[:, 1]))
    if not SMALLEST_M <= height <= LARGEST_M:
        raise BadMesh(
            f"the head is {height:.4g} high; with neck it should be {SMALLEST_M:g} to {LARGEST_M:g} metres: export the "
            "mesh in metres, +Y up"
        )
    return mesh.vertices.astype(np.float32)


def _check_faces(mesh: ObjMesh, head: HeadModel) -> None:
    """Check that the mesh has all edges of the model's faces and as many triangles; quads may be split.

    Raises:
        BadMesh: it has not.
    """
    wanted = _edges(head.polygons)
    missing = len(wanted) - int(np.isin(wanted, _edges(mesh.polygons)).sum())
    triangles = len(split_polygons(mesh.polygons))
    if missing or triangles != len(head.triangles):
        raise BadMesh(
            f"the mesh has other faces than the head model {head.name}: {missing} of its {len(wanted)} edges are "
            f"missing, {triangles} triangles instead of {len(head.triangles)}; start from mesh/head.obj of an archive "
            "and keep its topology",
            edges_missing=missing,
        )


def _edges(polygons: AnyInt) -> Int64:
    """Sorted, distinct directed edges of polygons (P, 4), each as one integer."""
    return _by_edge(polygons, np.zeros_like(polygons), np.zeros((1, 2)))[0]


def _check_chart(mesh: ObjMesh, head: HeadModel) -> None:
    """Check that every corner has the model's chart coordinates; a vertex on a seam has several, by face.

    Raises:
        BadMesh: a corner has none or others.
    """
    if (mesh.polygon_uv[:, :3] < 0).any():
        raise BadMesh("the mesh has faces without texture coordinates (vt); export it with those of mesh/head.obj")
    wanted, found = (_by_edge(polygons, chart, uv) for polygons, chart, uv in (
        (head.polygons, head.polygon_uv, head.uv), (mesh.polygons, mesh.polygon_uv, mesh.uv),
    ))  # fmt: skip
    shared = np.isin(found[0], wanted[0])
    place = np.searchsorted(wanted[0], found[0][shared])
    off = np.abs(found[1][shared] - wanted[1][place]).max(1)
    worst = float(off.max(initial=0.0))
    if worst > CHART_TOLERANCE:
        corners = int((off > CHART_TOLERANCE).sum())
        raise BadMesh(
            f"the mesh's texture coordinates differ from the head model's by up to {worst:.3f} ({corners} corners); "
            "maps belong to the model's chart: keep the vt of mesh/head.obj",
            worst=worst,
        )


def _by_edge(
    polygons: AnyInt, chart: AnyInt, uv: AnyFloat
) -> tuple[Int64, Float64]:
    """(E,) sorted directed edges as integers, and (E, 2) chart coordinates of the corner at which each begins.

    Args:
        polygons: (P, 4) vertices; the fourth is -1 in triangles.
        chart: (P, 4) rows of ``uv``.
        uv: (U, 2) chart coordinates.
    """
    corners, at = np.asarray(polygons, np.int64), np.asarray(chart, np.int64)
    quad = corners[:, 3] >= 0
    last = np.where(quad, corners[:, 3], corners[:, 2])
    last_at = np.where(quad, at[:, 3], at[:, 2])
    starts = np.concatenate([corners[:, 0], corners[:, 1], corners[quad][:, 2], last])
    stops = np.concatenate([corners[:, 1], corners[:, 2], corners[quad][:, 3], corners[:, 0]])
    places = np.concatenate([at[:, 0], at[:, 1], at[quad][:, 2], last_at])
    keys, first = np.unique((starts << 32) | stops, return_index=True)
    return keys, np.asarray(uv, np.float64)[places[first]]
