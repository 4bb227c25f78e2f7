"""Triangles cut along a line of a field over their vertices, and split in four.

Vertices are rows of columns: positions, texture coordinates, whatever is linear over a triangle.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Bool, Float64, Int64


def split(columns: Float64, triangles: Int64, chosen: Bool) -> tuple[Float64, Int64]:
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
