"""Triangles of one surface that cross those of another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

TOUCH_M = 5e-5
"""Depth in metres up to which surfaces touch rather than cross."""


def crossing_pairs(vertices: Float, first: Int, second: Int, touch: float = TOUCH_M) -> Int:
    """(P, 2) rows of ``first`` and ``second`` that cross; pairs that share a vertex do not count.

    Two triangles cross where an edge of one passes through the other, with both ends farther than ``touch`` from its
    plane.

    Args:
        vertices: (V, 3) metres.
        first: (T, 3) triangles.
        second: (S, 3) triangles.
        touch: metres.
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.int64)
    pairs = _near(vertices, first, second)
    a, b = first[pairs[:, 0]], second[pairs[:, 1]]
    apart = ~(a[:, :, None] == b[:, None, :]).any((1, 2))
    pairs, a, b = pairs[apart], vertices[a[apart]], vertices[b[apart]]
    hit = np.zeros(len(pairs), bool)
    for one, other in ((a, b), (b, a)):
        for k in range(3):
            hit |= _pierces(one[:, k], one[:, (k + 1) % 3], other, touch)
    return np.asarray(pairs[hit])


def _near(vertices: Float, first: Int, second: Int) -> Int:
    """(P, 2) pairs whose bounding boxes overlap."""
    boxes = [(vertices[t].min(1), vertices[t].max(1)) for t in (first, second)]
    centre = [(low + high) / 2 for low, high in boxes]
    reach = [np.linalg.norm(high - low, axis=1) / 2 for low, high in boxes]
    near = cKDTree(centre[1]).query_ball_point(centre[0], reach[0] + reach[1].max())
    rows = np.repeat(np.arange(len(first)), [len(n) for n in near])
    columns = np.concatenate([np.asarray(n, np.int64) for n in near]) if len(rows) else np.zeros(0, np.int64)
    overlap = (boxes[0][0][rows] <= boxes[1][1][columns]) & (boxes[1][0][columns] <= boxes[0][1][rows])
    kept = overlap.all(1)
    return np.stack([rows[kept], columns[kept]], 1).astype(np.int64)


def _pierces(start: Float, end: Float, corners: Float, touch: float) -> npt.NDArray[np.bool_]:
    """(P,) True where the segment from start to end (P, 3) passes through a triangle (P, 3, 3)."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(u, v)
    size = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(size, 1e-18)[:, None]
    d0, d1 = (((point - corners[:, 0]) * unit).sum(1) for point in (start, end))
    passes = (d0 * d1 < 0) & (np.minimum(np.abs(d0), np.abs(d1)) > touch) & (size > 1e-16)
    share = d0 / np.where(passes, d0 - d1, 1.0)
    at = start + share[:, None] * (end - start) - corners[:, 0]
    area = np.maximum(size**2, 1e-30)
    s = (np.cross(at, v) * normal).sum(1) / area
    t = (np.cross(u, at) * normal).sum(1) / area
    return np.asarray(passes & (s > 0) & (t > 0) & (s + t < 1))
