"""Smooth fields over the vertices of the mesh.

Completion works on the mesh and not on the chart: the mesh has no cut, so what is continued around the back of the head
meets itself, and islands that touch on the surface but not on the chart (ears, neck) are neighbours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from service.arrays import Float64
from service.errors import NumericFault

if TYPE_CHECKING:  # scipy.sparse takes 0.1 s to import, and is not needed before a photo is decoded
    from scipy.sparse import csc_array


LARGE_JUMP = 0.15
"""Difference of similarity over which an edge's weight falls to 1 / e."""

LEAST_WEIGHT = 0.02
"""Weight of an edge over any jump: colours that come from nowhere else still come over it."""


def laplacian(
    triangles: npt.NDArray[np.integer], count: int, similarity: npt.NDArray[np.floating] | None = None
) -> csc_array:
    """Weighted graph Laplacian (V, V) of a mesh's edges: x^T L x = sum over edges of w |x_i - x_j|^2.

    Args:
        triangles: (T, 3) vertex indices; a corner that is named twice makes no edge.
        count: number of vertices V; those of no triangle have a row of zeros.
        similarity: (V,) values whose difference along an edge weakens it, so that colours flow less where it jumps:
            w = exp(-(difference / LARGE_JUMP)^2) + LEAST_WEIGHT. Without it w = 1.
    """
    from scipy.sparse import coo_array, diags_array

    t = np.asarray(triangles, np.int64)
    pairs = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    one, other = np.divmod(np.unique(pairs[:, 0] * count + pairs[:, 1]), count)
    weight = np.ones(len(one))
    if similarity is not None:
        jump = np.asarray(similarity, np.float64)[one] - np.asarray(similarity, np.float64)[other]
        weight = np.exp(-((jump / LARGE_JUMP) ** 2)) + LEAST_WEIGHT
    rows, columns = np.concatenate([one, other]), np.concatenate([other, one])
    adjacency = coo_array((np.concatenate([weight, weight]), (rows, columns)), (count, count)).tocsc()
    return (diags_array(adjacency.sum(axis=0)) - adjacency).tocsc()


def smooth_fit(
    edges: csc_array,
    values: npt.NDArray[np.floating],
    trust: npt.NDArray[np.floating],
    smoothness: float,
    prior: npt.NDArray[np.floating],
    prior_trust: float,
) -> Float64:
    """Smooth field x (V, C) near what is known.

    Minimises sum trust |x - values|^2 + prior_trust |x - prior|^2 + smoothness sum w |x_i - x_j|^2.

    The normal equations are sparse, symmetric and positive definite, so they are factored directly: for the shipped
    head in less time than a good iteration takes to come near, and exact to rounding.

    Args:
        edges: :func:`laplacian` of the mesh.
        values: (V, C), read only where ``trust`` > 0.
        trust: (V,) >= 0, finite.
        smoothness: >= 0; larger is smoother.
        prior: (V, C) or (C,) what holds where nothing else is known.
        prior_trust: > 0, so that the system has one solution for any trust.

    Raises:
        ValueError: ``prior_trust`` is not above 0.
        NumericFault: a trust, a trusted value or the prior is NaN or Inf.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    k = np.asarray(trust, np.float64)[:, None]
    goal = np.broadcast_to(np.asarray(prior, np.float64), values.shape)
    right = np.where(k > 0, k * np.where(k > 0, values, 0.0), 0.0) + prior_trust * goal
    if not prior_trust > 0:
        raise ValueError(f"prior_trust is {prior_trust}; it has to be above 0, or nothing holds where nothing is known")
    if not (np.isfinite(k).all() and np.isfinite(right).all()):
        raise NumericFault("a trust, a trusted value or the prior is NaN or Inf; no smooth field fits it")
    system = (diags_array(k[:, 0] + prior_trust) + smoothness * edges).tocsc()
    # What SuperLU recommends for a system that is symmetric and dominated by its diagonal: no pivoting, an ordering of
    # A^T + A. Measured: it takes a quarter of the time that this ordering takes with pivoting.
    factors = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factors.solve(right), np.float64)


def splat(
    triangles: npt.NDArray[np.integer],
    barycentric: npt.NDArray[np.floating],
    values: npt.NDArray[np.floating],
    weight: npt.NDArray[np.floating],
    count: int,
) -> tuple[Float64, Float64]:
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
