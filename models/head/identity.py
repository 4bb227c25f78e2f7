"""From sampled heads to a mean and identity components in standard deviations.

Heads are brought into one frame by rotation and translation over the face (orthogonal Procrustes, no scale: size
stays a property of the head). Each is split into a part that is symmetric and one that is antisymmetric under
mirroring, and both get their own principal components, so every component is one or the other exactly. This equals
the PCA of the sample together with its mirror images.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
FLIP = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Identity:
    """mean (V, 3) and components (K, V, 3) in metres per standard deviation, by variance; share: (K,) of all
    variance.
    """

    mean: Float
    components: Float
    share: Float


def vertex_areas(vertices: Float, triangles: npt.NDArray[np.int64]) -> Float:
    """(V,) a third of the area of the triangles around each vertex."""
    corner = vertices[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return np.asarray(np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=len(vertices)), np.float64)


def align(points: Float, target: Float, weight: Float) -> Float:
    """Rotate and translate (V, 3) points onto target, least squares with (V,) weights (Kabsch 1976)."""
    w = weight / weight.sum()
    centre, goal = w @ points, w @ target
    u, _, vt = np.linalg.svd(((points - centre) * w[:, None]).T @ (target - goal))
    u[:, -1] *= np.sign(np.linalg.det(u @ vt))
    return np.asarray((points - centre) @ (u @ vt) + goal)


def _components(rows: npt.NDArray[np.floating[Any]], weight: Float, count: int) -> tuple[Float, Float]:
    """Leading principal directions of (N, V, 3) offsets without mean: (count, V, 3) times their standard deviation."""
    n = len(rows)
    scaled = (rows * np.sqrt(weight).astype(np.float32)[None, :, None]).reshape(n, -1)
    values, vectors = np.linalg.eigh((scaled @ scaled.T).astype(np.float64) / n)
    order = np.argsort(values)[::-1][:count]
    # a component per standard deviation: coefficients sqrt(n) v have variance 1, so the direction is rows^T v / sqrt(n)
    directions = np.tensordot(vectors[:, order].T.astype(np.float32), rows, 1) / np.sqrt(n)
    return np.asarray(directions), np.asarray(values[order])


def identity_basis(
    heads: npt.NDArray[np.floating[Any]], mirror: npt.NDArray[np.int64], weight: Float, count: int
) -> Identity:
    """Mean and components of (N, V, 3) aligned heads.

    Args:
        heads: metres, all in one frame.
        mirror: (V,) partner of each vertex.
        weight: (V,) non-negative weight of a vertex's variance (area times importance).
        count: number of components K.
    """
    mean = heads.mean(0, dtype=np.float64)
    mean = 0.5 * (mean + mean[mirror] * FLIP)
    mean = np.asarray(mean, np.float64)
    total = 0.0
    parts = []
    for sign in (1.0, -1.0):
        half = 0.5 * (heads + np.float32(sign) * heads[:, mirror] * FLIP.astype(np.float32))
        half = half - mean.astype(np.float32) if sign > 0 else half
        total += float(((half.astype(np.float32) ** 2).sum(2) @ weight.astype(np.float32)).mean())
        parts.append(_components(half, weight, count))
    directions = np.concatenate([part[0] for part in parts])
    variance = np.concatenate([part[1] for part in parts])
    order = np.argsort(-variance, kind="stable")[:count]
    chosen = directions[order]
    sign = np.sign(chosen.reshape(count, -1)[np.arange(count), np.abs(chosen.reshape(count, -1)).argmax(1)])
    return Identity(mean, chosen * sign[:, None, None], variance[order] / total)
