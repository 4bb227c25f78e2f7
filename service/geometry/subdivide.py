"""Meshes divided: Catmull-Clark subdivision of quads and triangles, triangles split in four or cut along a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, AnyInt, Bool, Float64, Int64


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
        around = _sum(flat, inner[owner], len(self.edges)) / np.maximum(faces_of_edge, 1)[:, None]
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
        face_mean = _sum(corner, inner[owner], self.count) / n
        edge_count = np.bincount(ends, minlength=self.count)[:, None]
        edge_mean = _sum(ends, middle[index], self.count) / np.maximum(edge_count, 1)
        smooth = (face_mean + 2 * edge_mean + (n - 3) * v) / n
        # On an open border only its two edges count; points where more than two border edges meet are kept.
        open_ends = border[index]
        borders = np.bincount(ends[open_ends], minlength=self.count)[:, None]
        along = _sum(ends[open_ends], middle[index[open_ends]], self.count) / np.maximum(borders, 1)
        result = np.where(borders == 2, 0.5 * (v + along), v)
        return np.where((borders == 0) & (valence > 0), smooth, result)


def _sum(index: Int64, rows: Float64, count: int) -> Float64:
    """(count, C) sums of rows (N, C) by index (N,)."""
    return np.stack([np.bincount(index, rows[:, i], count) for i in range(rows.shape[1])], 1)


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


def clipped(columns: Float64, triangles: Int64, field: Float64) -> tuple[Float64, Int64]:
    """What of triangles lies where a field (N,) over the vertices, linear between them, is above 0.

    Vertices that nothing uses any more are left out.
    """
    above = field[triangles] > 0
    count = above.sum(1)
    kept = [triangles[count == 3]]
    made = [columns]
    total = len(columns)

    def on_edge(inner: Int64, outer: Int64) -> Int64:
        nonlocal total
        share = field[inner] / np.maximum(field[inner] - field[outer], 1e-12)
        made.append(columns[inner] + share[:, None] * (columns[outer] - columns[inner]))
        total += len(inner)
        return np.arange(total - len(inner), total)

    one = triangles[count == 1]
    turned = np.take_along_axis(one, (np.argmax(above[count == 1], 1)[:, None] + np.arange(3)) % 3, 1)
    a, b, c = turned.T
    kept.append(np.stack([a, on_edge(a, b), on_edge(a, c)], 1))
    two = triangles[count == 2]
    turned = np.take_along_axis(two, (np.argmin(above[count == 2], 1)[:, None] + np.arange(3)) % 3, 1)
    a, b, c = turned.T
    ab, ac = on_edge(b, a), on_edge(c, a)
    kept += [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)]
    every = np.concatenate(kept)
    used, place = np.unique(every, return_inverse=True)
    return np.concatenate(made)[used], place.reshape(-1, 3)
