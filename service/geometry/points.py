"""Sampling of a mesh surface by points."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Float64


def surface_points(vertices: AnyFloat, triangles: AnyInt, spacing: float) -> Float32:
    """(N, 3) float32 points on all triangles, degenerate ones too, at most ``spacing`` apart.

    Args:
        vertices: (V, 3) in the unit of ``spacing``.
        triangles: (T, 3) vertex indices.
        spacing: largest distance of neighbours; a triangle's side is divided into at most 256 parts.
    """
    corners = np.asarray(vertices, np.float64)[triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1)
    steps = np.clip(np.ceil(edges / spacing), 1, 256).astype(int)
    points = []
    for n in np.unique(steps):
        i, j = np.divmod(np.arange((n + 1) ** 2), n + 1)
        keep = i + j <= n
        weights = np.stack([i, j, n - i - j], 1)[keep] / n
        points.append(np.einsum("kc,tcd->tkd", weights, corners[steps == n]).reshape(-1, 3))
    if not points:
        return np.zeros((0, 3), np.float32)
    return thinned(np.concatenate(points), 1e-3 * spacing).astype(np.float32)


def thinned(points: Float64, grain: float) -> Float64:
    """(M, 3) of points (N, 3), N > 0: one per cube of side ``grain``; triangles share corners and edges."""
    cell = np.rint((points - points.min(0)) / grain).astype(np.int64)
    x, y, z = np.minimum(cell, (1 << 21) - 1).T
    _, first = np.unique((x << 42) | (y << 21) | z, return_index=True)
    return np.asarray(points[np.sort(first)])
