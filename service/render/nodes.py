"""A fine grid on what is seen of a mesh: light is computed at its nodes and read between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Int64
from service.geometry.normals import normalise

NODES_M = 0.0008
"""Largest distance of the points at which light is computed, metres: a third of the height of a narrow eye's white."""
MOST_STEPS = 8
"""Most parts into which a triangle's side is divided for it."""


@dataclass(frozen=True)
class Nodes:
    """A grid on triangles, N points, and F places between them.

    Attributes:
        points: (N, 3) metres.
        normals: (N, 3) unit.
        corners: (F, 3) nodes around each place, and their ``weights`` (F, 3), sum 1.
    """

    points: Float32
    normals: Float32
    corners: Int64
    weights: Float32

    @classmethod
    def of(cls, points: AnyFloat, normals: AnyFloat, triangles: AnyInt, triangle: Int64, barycentric: Float32) -> Nodes:
        """Divide the triangles that hold places so that no side is longer than ``NODES_M``.

        Args:
            points: (V, 3) metres.
            normals: (V, 3).
            triangles: (T, 3).
            triangle: (F,) of each place.
            barycentric: (F, 3) of each place in it.
        """
        seen, which = np.unique(triangle, return_inverse=True)
        at = np.asarray(points, np.float64)[triangles[seen]]
        longest = float(np.linalg.norm(at - np.roll(at, 1, 1), axis=2).max(initial=0.0))
        steps = int(np.clip(np.ceil(longest / NODES_M), 1, MOST_STEPS))
        cell, inside = _lattice(barycentric, steps)
        keys, index = _numbered(triangles[seen][which], cell, steps)
        corner, share = keys[:, :3], keys[:, 3:] / np.float64(steps)
        place, normal = (np.einsum("nk,nkc->nc", share, np.asarray(v, np.float64)[corner]) for v in (points, normals))
        return cls(place.astype(np.float32), normalise(normal).astype(np.float32), index, inside)

    def read(self, values: Float32) -> Float32:
        """(F, C) of values (N, C)."""
        return np.asarray(np.einsum("fk,fkc->fc", self.weights, values[self.corners]), np.float32)


def _lattice(barycentric: Float32, steps: int) -> tuple[Int64, Float32]:
    """The three lattice points (F, 3, 3), in steps along each coordinate, around places, and their weights (F, 3)."""
    scaled = np.clip(np.asarray(barycentric, np.float64), 0, 1) * steps
    whole = np.minimum(np.floor(scaled), steps - 1).astype(np.int64)
    # A place on a corner or side is within the cell before it.
    over = np.maximum(whole.sum(1) - (steps - 1), 0)
    most = whole.argmax(1)
    whole[np.arange(len(whole)), most] -= over
    part = np.clip(scaled - whole, 0, 1)
    down = whole.sum(1) == steps - 2
    unit = np.eye(3, dtype=np.int64)[None]
    cell = whole[:, None, :] + np.where(down[:, None, None], 1 - unit, unit)
    weights = np.where(down[:, None], 1 - part, part)
    return cell, (weights / np.maximum(weights.sum(1, keepdims=True), 1e-9)).astype(np.float32)


def _numbered(corners: AnyInt, cell: Int64, steps: int) -> tuple[Int64, Int64]:
    """(N, 6) distinct lattice points, as three vertices and their steps, and (F, 3) which of them each is."""
    vertex = np.broadcast_to(corners[:, None, :], cell.shape).astype(np.int64)
    # A point on a side has the same key in both triangles: vertices that do not count are all the same.
    vertex = np.where(cell > 0, vertex, -1)
    order = np.argsort(vertex, axis=2, kind="stable")
    keys = np.concatenate([np.take_along_axis(a, order, 2) for a in (vertex, cell)], 2).reshape(-1, 6)
    distinct, index = np.unique(keys, axis=0, return_inverse=True)
    distinct[:, :3] = np.where(distinct[:, :3] < 0, distinct[:, 2:3], distinct[:, :3])
    return distinct, index.reshape(-1, 3)
