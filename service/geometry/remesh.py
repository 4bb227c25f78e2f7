"""Meshes with more triangles, and with fewer.

More: Catmull-Clark subdivision of quads and triangles, triangles split in four.

Fewer: half-edge collapses with quadric errors (Garland and Heckbert 1997), many at a time. A collapse moves one vertex
onto a neighbour, so what is left is a subset of the vertices, and whatever they carry stays right. A vertex at a cut of
the texture only moves along the cut, on both sides at once; one at an open border only along it. Collapses of one round
are so far apart that none changes what another was judged by; the order depends on nothing but the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from service.arrays import AnyFloat, AnyInt, Bool, Float64, Int64
from service.geometry.mesh import face_normals, summed


@dataclass(frozen=True)
class Subdivision:
    """One step, prepared for the topology of a mesh and applicable to any values at its points.

    The new points are the old ones, then one per face, then one per edge.

    Attributes:
        faces: (F, 4) int64, -1 in the last column marks a triangle.
        edges: (E, 2) int64 ends of each edge.
        side: (F, 4) int64 edge from each corner to the next, -1 where there is none.
        quads: (sum of corners, 4) int64 new faces: all of the first face, all of the second, ...
        owner: (len(quads),) int64 the face that each comes from.
        count: number of old points.
    """

    faces: Int64
    edges: Int64
    side: Int64
    quads: Int64
    owner: Int64
    count: int

    @classmethod
    def of(cls, faces: AnyInt, count: int) -> Subdivision:
        """Prepare a step for (F, 4) faces of ``count`` points."""
        f = np.asarray(faces, np.int64)
        corners = 3 + (f[:, 3] >= 0)
        there = np.arange(4) < corners[:, None]
        rows = np.arange(len(f))[:, None]
        following = f[rows, (np.arange(4) + 1) % corners[:, None]]
        ends = np.sort(np.stack([f, following], 2)[there], 1)
        edges, index = np.unique(ends, axis=0, return_inverse=True)
        side = np.full(f.shape, -1, np.int64)
        side[there] = index.ravel()
        before = side[rows, (np.arange(4) - 1) % corners[:, None]]
        face_point = count + np.broadcast_to(rows, f.shape)
        edge_point = count + len(f)
        quads = np.stack([f, edge_point + side, face_point, edge_point + before], 2)[there]
        return cls(f, edges, side, quads, np.repeat(np.arange(len(f)), corners), count)

    def linear(self, values: AnyFloat) -> Float64:
        """(N, C) values at the new points of (count, C): means, old points stay. For chart coordinates."""
        v = np.asarray(values, np.float64)
        return np.concatenate([v, self._face_means(v), v[self.edges].mean(1)])

    @property
    def faces_of_edge(self) -> Int64:
        """(E,) how many faces each edge has: one at an open border."""
        return np.asarray(np.bincount(self.side[self.side >= 0], minlength=len(self.edges)), np.int64)

    def open_points(self) -> Bool:
        """(N,) whether each new point lies on an open border."""
        there = np.zeros(self.count + len(self.faces) + len(self.edges), bool)
        border = np.flatnonzero(self.faces_of_edge == 1)
        there[self.edges[border]] = True
        there[self.count + len(self.faces) + border] = True
        return there

    def smooth(self, values: AnyFloat) -> Float64:
        """(N, C) values at the new points by the rules of Catmull and Clark; open borders stay on their own curve."""
        v = np.asarray(values, np.float64)
        inner = self._face_means(v)
        middle = v[self.edges].mean(1)
        there = self.side >= 0
        flat, owner = self.side[there], np.nonzero(there)[0]
        faces_of_edge = self.faces_of_edge
        around = summed(flat, inner[owner], len(self.edges)) / np.maximum(faces_of_edge, 1)[:, None]
        border = faces_of_edge != 2
        on_edges = np.where(border[:, None], middle, 0.5 * (middle + around))
        return np.concatenate([self._corners(v, inner, middle, border), inner, on_edges])

    def _face_means(self, v: Float64) -> Float64:
        there = (self.faces >= 0)[..., None]
        return np.asarray((v[np.maximum(self.faces, 0)] * there).sum(1) / there.sum(1))

    def _corners(self, v: Float64, inner: Float64, middle: Float64, border: Bool) -> Float64:
        there = self.faces >= 0
        corner, owner = self.faces[there], np.nonzero(there)[0]
        valence = np.bincount(corner, minlength=self.count)[:, None]
        ends, index = self.edges.ravel(), np.repeat(np.arange(len(self.edges)), 2)
        n = np.maximum(valence, 1)
        face_mean = summed(corner, inner[owner], self.count) / n
        edge_count = np.bincount(ends, minlength=self.count)[:, None]
        edge_mean = summed(ends, middle[index], self.count) / np.maximum(edge_count, 1)
        smooth = (face_mean + 2 * edge_mean + (n - 3) * v) / n
        # On an open border only its two edges count; points where more than two border edges meet are kept.
        open_ends = border[index]
        borders = np.bincount(ends[open_ends], minlength=self.count)[:, None]
        along = summed(ends[open_ends], middle[index[open_ends]], self.count) / np.maximum(borders, 1)
        result = np.where(borders == 2, 0.5 * (v + along), v)
        return np.where((borders == 0) & (valence > 0), smooth, result)


def split_in_four(columns: Float64, triangles: Int64, chosen: Bool) -> tuple[Float64, Int64]:
    """The chosen triangles in four at the middles of their edges; columns (N, k) are interpolated."""
    own = triangles[chosen]
    if not len(own):
        return columns, triangles
    edges = np.sort(np.stack([own, np.roll(own, -1, 1)], 2), 2).reshape(-1, 2)
    unique, place = np.unique(edges, axis=0, return_inverse=True)
    middle = place.reshape(-1, 3) + len(columns)
    a, b, c = own.T
    ab, bc, ca = middle.T
    new = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], 1).reshape(-1, 3)
    # In the place of the old one: triangles are drawn in their order.
    count = np.where(chosen, 4, 1)
    start = np.cumsum(count) - count
    result = np.zeros((int(count.sum()), 3), np.int64)
    result[start[~chosen]] = triangles[~chosen]
    result[(start[chosen][:, None] + np.arange(4)).ravel()] = new
    return np.concatenate([columns, columns[unique].mean(1)]), result


@dataclass(frozen=True)
class _Edges:
    """Directed edges (E,) from a vertex to a neighbour onto which it may go."""

    start: Int64
    end: Int64


def collapsed(points: Sequence[AnyFloat], triangles: AnyInt, vertex: AnyInt, wanted: Sequence[int]) -> list[Int64]:
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
            # A round that takes away less than one vertex in so many triangles is the last.
            idle = len(chosen.start) * 2000 <= len(left)
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
    normal = face_normals(points, corners)
    size = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(size, 1e-18)[:, None]
    out = np.zeros((len(points), 4, 4))
    _add(out, corners, unit, points[corners[:, 0]], size / 2)
    ends = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    alone = ~_in_both(ends, vertex)
    start, end = (points[vertex[ends[alone, k]]] for k in (0, 1))
    along, across = end - start, np.concatenate([unit] * 3)[alone]
    wall = np.cross(along, across)
    length = np.linalg.norm(along, axis=1)
    wall /= np.maximum(np.linalg.norm(wall, axis=1), 1e-18)[:, None]
    # Weight of the planes that hold open borders and cuts, of the area of a triangle.
    _add(out, vertex[ends[alone]], wall, start, 3.0 * length**2)
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
    # Neighbours that are tried for a vertex in one round, the cheapest first.
    for _ in range(3):
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
    # Share of the vertices, the cheapest, that may go in one round; among them chance decides, as in order of their
    # cost few would be the cheapest of their surroundings.
    order = order[: max(int(0.25 * len(order)), 1)]
    # Knuth's multiplier of hashes, for that chance.
    order = order[np.argsort(order * 2654435761 % 2**32, kind="stable")]
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
    wedge_count = len(vertex)
    edges_of_wedges = np.unique((index * wedge_count + wedges[:, 0]) * wedge_count + wedges[:, 1])
    partners = np.bincount(edges_of_wedges // wedge_count**2, minlength=len(keys))
    own = np.bincount(np.unique(edges_of_wedges // wedge_count) // wedge_count, minlength=len(keys))
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
        # Weight of an edge's squared length times its area: among flat places the short edges go first.
        total += 1e-4 * ((points[edges.start] - points[edges.end]) ** 2).sum(1) ** 2
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
            before, after = face_normals(points, corners[rows]), face_normals(points, moved)
            size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
            # No triangle may turn by more in one collapse than the angle with this cosine.
            turned[corners[rows, k][(before * after).sum(1) <= 0.2 * size]] = True
    return np.asarray(turned[start])


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
