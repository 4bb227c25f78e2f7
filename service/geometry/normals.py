"""Unit vectors: normalising, face normals and vertex normals."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, AnyInt, Float32, Float64

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

    Angle weights make the result independent of how a surface is cut into triangles. Triangles without area or with a
    corner that is not finite add nothing; a vertex of none but such triangles gets (0, 0, 1).

    Args:
        vertices: (V, 3) in any unit.
        triangles: (T, 3) vertex indices, counter-clockwise from outside.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        normal = normalise(face_normals(vertices, triangles), (0.0, 0.0, 0.0))
        weighted = corner_angles(vertices, triangles)[:, :, None] * normal[:, None]
    index = np.asarray(triangles).ravel()
    total = [np.bincount(index, weighted[..., i].ravel(), len(vertices)) for i in range(3)]
    return normalise(np.stack(total, 1))


def area_normals(vertices: AnyFloat, triangles: AnyInt) -> Float32:
    """Unit normals weighted by area, of many poses at once and several times faster than :func:`vertex_normals`.

    Args:
        vertices: (..., V, 3) positions, any number of poses.
        triangles: (T, 3) indices, counter-clockwise from outside.

    Returns:
        (..., V, 3) float32 of length 1; ``FALLBACK_NORMAL`` where the triangles around a vertex have no area.
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
