"""Which light reaches points past what stands around them: depth maps of occluders, by the light stage's graphs."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.light.graphs import Graphs
from service.light.sphere import spread_directions


def sky_seen(graphs: Graphs, count: int, points: Float32, occluders: Float32, spacing: float) -> UInt8:
    """(count, N) visibility of spread directions from points (6, N), 255 = fully visible; 0 below their horizon.

    Args:
        graphs: the formulas.
        count: of directions (``spread_directions``).
        points: position in mm and unit normal.
        occluders: (3, M) mm.
        spacing: of the occluders, mm.
    """
    seen = np.zeros((count, points.shape[1]), np.uint8)
    for k, direction in enumerate(spread_directions(count)):
        if not (direction @ points[3:] > 0).any():
            continue
        lit = graphs.lit("lit_from_direction", occluders, spacing, points, direction.astype(np.float32))
        seen[k] = np.rint(lit * 255.0)
    return seen


def lamp_seen(graphs: Graphs, places: AnyFloat, points: Float32, occluders: Float32, spacing: float) -> Float32:
    """(N,) mean share in [0, 1] of the light from places (K, 3) mm that reaches points; others as of `sky_seen`."""
    total = np.zeros(points.shape[1], np.float32)
    for at in places:
        total += graphs.lit("lit_from_point", occluders, spacing, points, at.astype(np.float32))
    return total / np.float32(len(places))


def summed(seen: UInt8, each: Float64) -> Float32:
    """(N, C) sums over directions of visibility codes (D, N) times (D, C)."""
    total = np.zeros((seen.shape[1], each.shape[1]), np.float32)
    for first in range(0, len(seen), 64):
        part = seen[first : first + 64].astype(np.float32) * np.float32(1 / 255)
        total += part.T @ each[first : first + 64].astype(np.float32)
    return total
