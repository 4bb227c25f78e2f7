"""Smooth fields over the vertices of the mesh.

Completion works on the mesh and not on the chart: the mesh has no cut, so what is continued around the back of the head
meets itself, and islands that touch on the surface but not on the chart (ears, neck) are neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

TOLERANCE = 3e-4
"""Relative residual at which the solver stops; colours are in [0, 1] and end as 8 bits."""

MOST_STEPS = 300

CLUSTER_M = 0.03
"""Side of the cells in which vertices are grouped for the coarse level of the solver."""


@dataclass(frozen=True)
class Graph:
    """Edges of a triangle mesh in both directions, sorted by origin.

    Attributes:
        origin, target: (2E,) int64 vertex indices.
        first: (A,) int64 position of each origin's first edge; ``active`` (A,) int64 are those origins.
        count: number of vertices V.
        weight: (2E,) float64 > 0, symmetric.
        cluster: (V,) int64 group of each vertex, 0 to ``clusters`` - 1; neighbours in space share one.
        clusters: number of groups.
    """

    origin: Ints
    target: Ints
    first: Ints
    active: Ints
    count: int
    weight: Array
    cluster: Ints
    clusters: int

    @classmethod
    def of(
        cls,
        triangles: npt.NDArray[np.integer],
        positions: npt.NDArray[np.floating],
        similarity: npt.NDArray[np.floating] | None = None,
    ) -> Graph:
        """Graph of the edges of (T, 3) triangles.

        Args:
            triangles: vertex indices.
            positions: (V, 3) metres, finite; only used to group vertices.
            similarity: (V,) values whose difference along an edge weakens it: colours flow less where it jumps.
        """
        count = len(positions)
        t = np.asarray(triangles, np.int64)
        pairs = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        key = np.unique(np.concatenate([pairs[:, 0] * count + pairs[:, 1], pairs[:, 1] * count + pairs[:, 0]]))
        origin, target = key // count, key % count
        active, first = np.unique(origin, return_index=True)
        weight = np.ones(len(origin))
        if similarity is not None:
            jump = np.asarray(similarity, np.float64)[origin] - np.asarray(similarity, np.float64)[target]
            weight = np.exp(-((jump / 0.15) ** 2)) + 0.02
        cell = np.floor((positions - positions.min(0)) / CLUSTER_M).astype(np.int64)
        name = (cell[:, 0] * 4096 + cell[:, 1]) * 4096 + cell[:, 2]
        kinds, cluster = np.unique(name, return_inverse=True)
        return cls(origin, target, first.astype(np.int64), active, count, weight, cluster.astype(np.int64), len(kinds))

    def gather(self, values: Array) -> Array:
        """(V, C) weighted sum over each vertex's neighbours of (V, C) values."""
        result = np.zeros((self.count, values.shape[1]))
        if len(self.first):
            # np.take: several times faster than values[target] on rows.
            along = np.take(values, self.target, axis=0)
            along *= self.weight[:, None]
            result[self.active] = np.add.reduceat(along, self.first, axis=0)
        return result


def smooth_fit(
    graph: Graph,
    values: npt.NDArray[np.floating],
    trust: npt.NDArray[np.floating],
    smoothness: float,
    prior: npt.NDArray[np.floating],
    prior_trust: npt.NDArray[np.floating] | float,
    tolerance: float = TOLERANCE,
) -> Array:
    """Smooth field x (V, C) near what is known.

    Minimises sum trust |x - values|^2 + prior_trust |x - prior|^2 + smoothness sum w |x_i - x_j|^2.

    Solved by conjugate gradients. Colours travel far over vertices about which nothing is known, so the preconditioner
    is the diagonal plus an exact solve for one value per cluster (additive two-level Schwarz).

    Args:
        graph: neighbours and the weights w.
        values: (V, C), read only where ``trust`` > 0.
        trust: (V,) >= 0.
        smoothness: >= 0; larger is smoother.
        prior: (V, C) or (C,) what holds where nothing else is known.
        prior_trust: (V,) or one number, > 0, so that the system has one solution for any trust.
        tolerance: relative residual at which to stop.
    """
    pull = np.broadcast_to(np.asarray(prior_trust, np.float64), (graph.count,))[:, None]
    k = np.asarray(trust, np.float64)[:, None]
    goal = np.broadcast_to(np.asarray(prior, np.float64), (graph.count, values.shape[1]))
    right = np.where(k > 0, k * np.where(k > 0, values, 0.0), 0.0) + pull * goal
    degree = graph.gather(np.ones((graph.count, 1)))
    diagonal = k + pull + smoothness * degree

    coarse = _coarse_inverse(graph, diagonal[:, 0], smoothness)

    def precondition(residual: Array) -> Array:
        sums = [np.bincount(graph.cluster, r, graph.clusters) for r in residual.T]
        return residual / diagonal + np.take(coarse @ np.stack(sums, 1), graph.cluster, axis=0)

    x = np.where(k > pull, np.where(k > 0, values, 0.0), goal).astype(np.float64)
    residual = right - diagonal * x + smoothness * graph.gather(x)
    enough = tolerance**2 * max(float(np.sum(right * right)), 1e-24)
    step = scaled = precondition(residual)
    power = np.sum(residual * scaled, 0)
    for _ in range(MOST_STEPS):
        if float(np.sum(residual * residual)) <= enough:
            break
        image = diagonal * step - smoothness * graph.gather(step)
        curvature = np.sum(step * image, 0)
        length = np.divide(power, curvature, out=np.zeros_like(power), where=curvature > 0)
        x = x + length * step
        residual = residual - length * image
        scaled = precondition(residual)
        last, power = power, np.sum(residual * scaled, 0)
        step = scaled + np.divide(power, last, out=np.zeros_like(power), where=last > 0) * step
    return x


def _coarse_inverse(graph: Graph, diagonal: Array, smoothness: float) -> Array:
    """Inverse (G, G) of the system restricted to fields that are constant on clusters."""
    size = graph.clusters
    pair = graph.cluster[graph.origin] * size + graph.cluster[graph.target]
    matrix = -smoothness * np.bincount(pair, graph.weight, size * size).reshape(size, size)
    matrix[np.diag_indices(size)] += np.bincount(graph.cluster, diagonal, size)
    return np.linalg.inv(matrix)


def splat(
    triangles: npt.NDArray[np.integer],
    barycentric: npt.NDArray[np.floating],
    values: npt.NDArray[np.floating],
    weight: npt.NDArray[np.floating],
    count: int,
) -> tuple[Array, Array]:
    """Weighted means of texel values around each vertex.

    Args:
        triangles: (N, 3) corners of each texel's triangle.
        barycentric: (N, 3) weights of the corners.
        values: (N, C).
        weight: (N,) >= 0.
        count: number of vertices V.

    Returns:
        (V, C) means (0 where nothing lies) and (V,) mean weight in the range of ``weight``.
    """
    chosen = np.flatnonzero(weight > 0)
    index = triangles[chosen].ravel()
    share = (barycentric[chosen] * weight[chosen, None]).ravel()
    total = np.bincount(index, share, count)
    area = np.bincount(triangles.ravel(), barycentric.ravel(), count)
    mean = np.zeros((count, values.shape[1]))
    safe = np.where(total > 0, total, 1.0)
    for channel in range(values.shape[1]):
        corner = np.repeat(values[chosen, channel], 3) * share
        mean[:, channel] = np.bincount(index, corner, count) / safe
    return mean, total / np.where(area > 0, area, 1.0)
