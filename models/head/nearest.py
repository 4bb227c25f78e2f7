"""Nearest point on triangles."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]


def nearest_on_triangles(corners: Float, points: Float) -> Float:
    """(N, 3) barycentric coordinates, in [0, 1] and of sum 1, of the point of triangle n nearest to point n.

    The nearest point is the foot of the perpendicular where that lies inside, else the best of the three edges. A
    triangle without area counts as its edges, an edge without length as its first end.

    Args:
        corners: (N, 3, 3) triangle corners.
        points: (N, 3).
    """
    best = np.zeros((len(points), 3))
    gap = np.full(len(points), np.inf)
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        along = b - a
        square = (along**2).sum(1)
        t = np.clip(((points - a) * along).sum(1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
        distance = ((a + t[:, None] * along - points) ** 2).sum(1)
        closer = distance < gap
        gap = np.where(closer, distance, gap)
        weight = np.zeros_like(best)
        weight[:, k], weight[:, (k + 1) % 3] = 1 - t, t
        best[closer] = weight[closer]
    e1, e2, to = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(e1, e2)
    square = (normal**2).sum(1)
    safe = np.where(square > 0, square, 1.0)
    v = (np.cross(to, e2) * normal).sum(1) / safe
    w = (np.cross(e1, to) * normal).sum(1) / safe
    inside = (square > 0) & (v >= 0) & (w >= 0) & (v + w <= 1)
    best[inside] = np.stack([1 - v - w, v, w], 1)[inside]
    return best
