"""Over the vertices of a mesh: unit vectors and normals, and smooth fields.

Completion works on the mesh and not on the chart: the mesh has no cut, so what is continued around the back of the head
meets itself, and islands that touch on the surface but not on the chart (ears, neck) are neighbours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int64
from service.errors import NumericFault

SMALLEST_LENGTH = 1e-20
"""Length below which a vector has no direction (a micrometre-sized triangle's normal has a length of 1e-12 m^2)."""

FALLBACK_NORMAL = (0.0, 0.0, 1.0)
"""For vertices whose triangles all have no area: forward, so that every normal has unit length."""


def normalise(vectors: AnyFloat, fallback: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Float64:
    """Unit vectors (..., 3) float64; ``fallback`` where a vector is shorter than ``SMALLEST_LENGTH`` or not finite."""
    v = np.asarray(vectors, np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.sqrt(np.einsum("...i,...i->...", v, v))
        sound = np.isfinite(length) & (length > SMALLEST_LENGTH)
        unit = v / np.where(sound, length, 1.0)[..., None]
    return np.where(sound[..., None], unit, np.asarray(fallback, np.float64))


def unit(vectors: AnyFloat) -> Float32:
    """Vectors (..., 3) float32 of length 1; those shorter than 1e-9 stay short."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return np.asarray(vectors / np.maximum(length, 1e-9)[..., None], np.float32)


def face_normals(vertices: AnyFloat, triangles: AnyInt) -> Float64:
    """(T, 3) float64 normals of (V, 3) vertices, outward for counter-clockwise corners, length twice the area."""
    v = np.asarray(vertices, np.float64)
    a, b, c = v[triangles[:, 0]], v[triangles[:, 1]], v[triangles[:, 2]]
    return np.asarray(np.cross(b - a, c - a))


def corner_angles(vertices: AnyFloat, triangles: AnyInt) -> Float64:
    """(T, 3) float64 angle at each corner in radians; 0 at a corner with an edge of no length."""
    p = np.asarray(vertices, np.float64)[triangles]
    to_next = normalise(np.roll(p, -1, 1) - p, (0.0, 0.0, 0.0))
    to_last = normalise(np.roll(p, 1, 1) - p, (0.0, 0.0, 0.0))
    cosine = np.einsum("tki,tki->tk", to_next, to_last)
    sound = to_next.any(2) & to_last.any(2)
    return np.where(sound, np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0)


def vertex_normals(vertices: AnyFloat, triangles: AnyInt) -> Float64:
    """(V, 3) float64 unit normals: face normals weighted by the corner's angle (Thuermer and Wuethrich 1998).

    Angle weights make the result independent of how a surface is cut into triangles (T, 3), counter-clockwise from
    outside. Triangles without area or with a corner that is not finite add nothing; a vertex of none but such triangles
    gets (0, 0, 1).
    """
    with np.errstate(invalid="ignore", over="ignore"):
        normal = normalise(face_normals(vertices, triangles), (0.0, 0.0, 0.0))
        weighted = corner_angles(vertices, triangles)[:, :, None] * normal[:, None]
    return normalise(summed(np.asarray(triangles).ravel(), weighted.reshape(-1, 3), len(vertices)))


def summed(index: AnyInt, rows: AnyFloat, count: int) -> Float64:
    """(count, C) float64 sums of rows (N, C) by index (N,): what corners of faces give to their vertices."""
    return np.stack([np.bincount(index, column, count) for column in rows.T], 1)


def area_normals(vertices: AnyFloat, triangles: AnyInt) -> Float32:
    """(..., V, 3) float32 unit normals weighted by area; several times faster than :func:`vertex_normals`.

    Of vertices (..., V, 3) in any number of poses and triangles (T, 3), counter-clockwise from outside;
    ``FALLBACK_NORMAL`` where the triangles around a vertex have no area.
    """
    from scipy.sparse import csr_array

    points = np.asarray(vertices, np.float32)
    count, poses = points.shape[-2], points.shape[:-2]
    origin = points[..., triangles[:, 0], :]
    faces = cross(points[..., triangles[:, 1], :] - origin, points[..., triangles[:, 2], :] - origin)
    corners = np.asarray(triangles, np.int64).ravel()
    owner = np.repeat(np.arange(len(triangles)), 3)
    around = csr_array((np.ones(len(corners), np.float32), (corners, owner)), shape=(count, len(triangles)))
    columns = np.moveaxis(faces.reshape(-1, len(triangles), 3), 1, 0).reshape(len(triangles), -1)
    sums = np.asarray(around @ columns).reshape(count, -1, 3)
    total = np.moveaxis(sums, 0, 1).reshape(*poses, count, 3)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    sound = length > np.finfo(np.float32).tiny
    return np.where(sound, total / np.where(sound, length, 1), np.array(FALLBACK_NORMAL, np.float32)).astype(np.float32)


def cross(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Cross product along the last axis; several times faster than numpy.cross on these sizes."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


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
    """(V, C) weighted means of texel values (N, C) around each vertex, and (V,) their mean weight; 0 where nothing
    lies.

    Each texel lies in a triangle with corners (N, 3), by barycentric weights (N, 3), and has a weight (N,) >= 0.
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


def spread_points(area: AnyFloat, each: float) -> tuple[Int64, Float64, AnyFloat]:
    """Points spread over triangles of these areas (T,), at least one on each.

    Of each point (M,) its triangle, weights (M, 3) of the corners, and the area around it, about ``each``.
    """
    count = np.maximum(1, np.ceil(area / each)).astype(int)
    index = np.repeat(np.arange(len(area)), count)
    order = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    return index, folded(order), (area / count)[index]


def folded(order: Int64) -> Float64:
    """(N, 3) barycentric weights of members of the low-discrepancy sequence R2, folded from the square."""
    u, v = (0.5 + order * 0.7548776662466927) % 1.0, (0.5 + order * 0.5698402909980532) % 1.0
    flip = u + v > 1.0
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return np.stack([1 - u - v, u, v], 1)
