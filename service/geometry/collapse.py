"""Fewer triangles by half-edge collapses with quadric errors (Garland and Heckbert 1997), many at a time.

A collapse moves one vertex onto a neighbour, so what is left is a subset of the vertices, and whatever they carry stays
right. A vertex at a cut of the texture only moves along the cut, on both sides at once; one at an open border only
along it. Collapses of one round are so far apart that none changes what another was judged by; the order depends on
nothing but the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from service.arrays import AnyFloat, AnyInt, Float64, Int64

Bool = npt.NDArray[np.bool_]

BORDER = 3.0
"""Weight of the planes that hold open borders and cuts, of the area of a triangle."""
SHORT = 1e-4
"""Weight of an edge's squared length times its area: among flat places the short edges go first."""
LEAST_COSINE = 0.2
"""No triangle may turn by more in one collapse than the angle with this cosine."""
TRIES = 3
"""Neighbours that are tried for a vertex in one round, the cheapest first."""
EAGER = 0.25
"""Share of the vertices, the cheapest, that may go in one round; among them chance decides, as in order of their cost
few would be the cheapest of their surroundings."""
SCATTER = 2654435761
"""Knuth's multiplier of hashes, for that chance."""
IDLE = 2000
"""A round that takes away less than one vertex in so many triangles is the last."""


@dataclass(frozen=True)
class _Edges:
    """Directed edges (E,) from a vertex to a neighbour onto which it may go."""

    start: Int64
    end: Int64


def collapsed(
    points: Sequence[AnyFloat], triangles: AnyInt, vertex: AnyInt, wanted: Sequence[int]
) -> list[Int64]:
    """For each number wanted (M, 3) triangles, about as many or as few as the topology allows.

    Args:
        points: one or more poses, (V, 3) each, in which the surface is to keep its shape.
        triangles: (T, 3) indices of wedges, counter-clockwise.
        vertex: (W,) vertex of each wedge; vertices of several wedges lie on cuts of the texture.
        wanted: numbers of triangles, descending.
    """
    scale = max(float(np.ptp(np.asarray(points[0]), axis=0).max()), 1e-12) if len(points[0]) else 1.0
    poses = [(np.asarray(one, np.float64) - np.mean(points[0], axis=0)) / scale for one in points]
    of: Int64 = np.asarray(vertex, np.int64)
    left: Int64 = np.asarray(triangles, np.int64)
    left = left[_proper(of[left])]
    quadrics, found = [_quadrics(pose, left, of) for pose in poses], []
    for number in wanted:
        idle = False
        while len(left) > number and not idle:
            chosen = _round(poses, quadrics, left, of, (len(left) - number + 1) // 2)
            idle = len(chosen.start) * IDLE <= len(left)
            left = _applied(chosen, left, of, len(poses[0]))
            for quadric in quadrics:
                np.add.at(quadric, chosen.end, quadric[chosen.start])
        found.append(left)
    return found


def _proper(corners: Int64) -> Bool:
    a, b, c = corners.T
    return np.asarray((a != b) & (b != c) & (c != a))


def _quadrics(points: Float64, triangles: Int64, vertex: Int64) -> Float64:
    """(V, 4, 4) sums of squared distances from the planes of triangles, and from those that hold borders and cuts."""
    corners = vertex[triangles]
    a, b, c = (points[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(size, 1e-18)[:, None]
    out = np.zeros((len(points), 4, 4))
    _add(out, corners, unit, a, size / 2)
    ends = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    alone = ~_in_both(ends, vertex)
    start, end = (points[vertex[ends[alone, k]]] for k in (0, 1))
    along, across = end - start, np.concatenate([unit] * 3)[alone]
    wall = np.cross(along, across)
    length = np.linalg.norm(along, axis=1)
    wall /= np.maximum(np.linalg.norm(wall, axis=1), 1e-18)[:, None]
    _add(out, vertex[ends[alone]], wall, start, BORDER * length**2)
    return out


def _add(out: Float64, corners: Int64, unit: Float64, at: Float64, weight: Float64) -> None:
    plane = np.concatenate([unit, -(unit * at).sum(1, keepdims=True)], 1)
    each = weight[:, None, None] * plane[:, :, None] * plane[:, None, :]
    for k in range(corners.shape[1]):
        np.add.at(out, corners[:, k], each)


def _in_both(ends: Int64, vertex: Int64) -> Bool:
    """Whether an edge of wedges (E, 2) has the same wedges in the triangle on its other side."""
    count = len(vertex)
    there = ends[:, 0] * count + ends[:, 1]
    return np.isin(ends[:, 1] * count + ends[:, 0], there)


def _round(poses: list[Float64], quadrics: list[Float64], left: Int64, vertex: Int64, most: int) -> _Edges:
    """Collapses that do not touch each other, at most ``most``, among the cheapest."""
    count = len(poses[0])
    edges, graph = _candidates(left, vertex, count)
    cost = _costs(poses, quadrics, edges)
    best, target = np.full(count, np.inf), np.full(count, -1, np.int64)
    corners = vertex[left]
    for _ in range(TRIES):
        order = np.lexsort((edges.end, cost, edges.start))
        order = order[np.isfinite(cost[order])]
        first = order[np.unique(edges.start[order], return_index=True)[1]]
        first = first[~np.isfinite(best[edges.start[first]])]
        turns = _turns(poses, corners, edges.start[first], edges.end[first])
        good = first[~turns]
        best[edges.start[good]], target[edges.start[good]] = cost[good], edges.end[good]
        cost[first] = np.inf
    may = np.flatnonzero(np.isfinite(best))
    order = may[np.lexsort((may, best[may]))]
    order = order[: max(int(EAGER * len(order)), 1)]
    order = order[np.argsort(order * SCATTER % 2**32, kind="stable")]
    rank = np.full(count, count, np.int64)
    rank[order] = np.arange(len(order))
    lowest = _lowest_near(graph, _lowest_near(graph, rank))
    chosen = order[rank[order] == lowest[order]][:most]
    return _Edges(chosen, target[chosen])


def _candidates(left: Int64, vertex: Int64, count: int) -> tuple[_Edges, csr_matrix]:
    """Directed edges whose collapse keeps the surface a surface and its cuts in place; and the graph of neighbours."""
    pairs = [(k, (k + d) % 3) for d in (1, 2) for k in range(3)]
    wedges = np.concatenate([left[:, pair] for pair in pairs])
    ends = vertex[wedges]
    keys, index, sides = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True, return_counts=True)
    start, end = keys // count, keys % count
    graph = csr_matrix((np.ones(len(keys), np.int32), (start, end)), shape=(count, count))
    common = np.asarray((graph @ graph)[start, end]).ravel()
    # Wedges of the start that the edge has, and their partners: each of the vertex's needs exactly one.
    number = np.unique(np.stack([index, wedges[:, 0], wedges[:, 1]], 1), axis=0)
    partners = np.bincount(number[:, 0], minlength=len(keys))
    own = np.bincount(np.unique(number[:, :2], axis=0)[:, 0], minlength=len(keys))
    whole = np.bincount(vertex[np.unique(left)], minlength=count)
    rim = np.zeros(count, bool)
    rim[start[sides == 1]] = True
    odd = np.zeros(count, bool)
    odd[start[sides > 2]] = True
    fits = (partners == own) & (own == whole[start]) & (common == sides) & (~rim[start] | (sides == 1))
    fits &= ~odd[start] & ~odd[end]
    return _Edges(start[fits], end[fits]), graph


def _costs(poses: list[Float64], quadrics: list[Float64], edges: _Edges) -> Float64:
    total = np.zeros(len(edges.start))
    for points, quadric in zip(poses, quadrics, strict=True):
        there = np.concatenate([points[edges.end], np.ones((len(edges.end), 1))], 1)
        total += np.einsum("ei,eij,ej->e", there, quadric[edges.start] + quadric[edges.end], there)
        total += SHORT * ((points[edges.start] - points[edges.end]) ** 2).sum(1) ** 2
    return np.maximum(total, 0.0)


def _turns(poses: list[Float64], corners: Int64, start: Int64, end: Int64) -> Bool:
    """Whether a collapse turns a triangle about, or makes one without area, of those that are left."""
    onto = np.full(len(poses[0]), -1, np.int64)
    onto[start] = end
    turned = np.zeros(len(poses[0]), bool)
    for k in range(3):
        own = onto[corners[:, k]]
        rows = np.flatnonzero((own >= 0) & ~(corners == own[:, None]).any(1))
        moved = corners[rows].copy()
        moved[:, k] = own[rows]
        for points in poses:
            before, after = _normals(points, corners[rows]), _normals(points, moved)
            size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
            turned[corners[rows, k][(before * after).sum(1) <= LEAST_COSINE * size]] = True
    return np.asarray(turned[start])


def _normals(points: Float64, corners: Int64) -> Float64:
    a, b, c = (points[corners[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _lowest_near(graph: csr_matrix, rank: Int64) -> Int64:
    """(V,) lowest rank of each vertex and its neighbours."""
    lowest, filled = rank.copy(), np.diff(graph.indptr) > 0
    lowest[filled] = np.minimum(rank[filled], np.minimum.reduceat(rank[graph.indices], graph.indptr[:-1][filled]))
    return lowest


def _applied(chosen: _Edges, left: Int64, vertex: Int64, count: int) -> Int64:
    onto = np.full(count, -1, np.int64)
    onto[chosen.start] = chosen.end
    corners = vertex[left]
    wedge = np.arange(len(vertex))
    for k in range(3):
        for other in ((k + 1) % 3, (k + 2) % 3):
            rows = onto[corners[:, k]] == corners[:, other]
            wedge[left[rows, k]] = left[rows, other]
    made = wedge[left]
    return made[_proper(vertex[made])]
