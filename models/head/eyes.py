"""Smooth eyeballs that follow the coarse ones of the base mesh linearly.

The base mesh marks each eyeball by 72 vertices on a sphere. Ours are finer, with rings around the line of sight so
that iris and pupil have round edges. Every point of our sphere is written as an affine combination of the 72 vertices
that reproduces every affine map exactly; so whatever moves, turns, scales or shears the coarse eyeball does the same
to the fine one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

RINGS_DEG = (5.0, 10.0, 15.0, 19.0, 23.0, 27.0, 33.0, 41.0, 51.0, 63.0, 77.0, 93.0, 112.0, 134.0, 157.0)
"""Polar angles of the vertex rings, measured from the line of sight (+Z); the chart is laid out by them too."""
SEGMENTS = 24


def sphere(rings_deg: tuple[float, ...] = RINGS_DEG) -> tuple[Float, Int]:
    """Unit sphere: (N, 3) points, front pole first, back pole last, and (Q, 4) polygons (-1 pads triangles)."""
    theta = np.radians(rings_deg)[:, None]
    phi = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    ring = np.stack(
        [
            np.sin(theta) * np.cos(phi),
            np.sin(theta) * np.sin(phi),
            np.broadcast_to(np.cos(theta), (len(theta), SEGMENTS)),
        ],
        -1,
    )
    points = np.concatenate([[[0.0, 0.0, 1.0]], ring.reshape(-1, 3), [[0.0, 0.0, -1.0]]])
    here = np.arange(SEGMENTS)
    after = (here + 1) % SEGMENTS
    last = len(points) - 1
    none = np.full(SEGMENTS, -1)
    polygons = [np.stack([np.zeros(SEGMENTS, int), 1 + here, 1 + after, none], 1)]
    for k in range(len(rings_deg) - 1):
        a = 1 + k * SEGMENTS
        b = a + SEGMENTS
        polygons.append(np.stack([a + here, b + here, b + after, a + after], 1))
    a = 1 + (len(rings_deg) - 1) * SEGMENTS
    polygons.append(np.stack([np.full(SEGMENTS, last), a + after, a + here, none], 1))
    return points, np.concatenate(polygons)


def affine_weights(coarse: Float, points: Float) -> Float:
    """(N, 72) least-norm weights with ``weights @ A(coarse) == A(points)`` for every affine map A.

    Args:
        coarse: (72, 3) marks of the eyeball.
        points: (N, 3) wanted points in the same frame.
    """
    homogeneous = np.c_[coarse, np.ones(len(coarse))]
    return np.asarray(np.c_[points, np.ones(len(points))] @ np.linalg.pinv(homogeneous))


def eyeball(coarse: Float) -> tuple[Float, Int]:
    """Weights (N, 72) and polygons (Q, 4) of the fine eyeball for (72, 3) marks on a sphere."""
    system = np.c_[2 * coarse, np.ones(len(coarse))]
    fit = np.linalg.lstsq(system, (coarse**2).sum(1), rcond=None)[0]  # |x|^2 = 2 c.x + (r^2 - |c|^2)
    centre = fit[:3]
    radius = float(np.sqrt(fit[3] + centre @ centre))
    points, polygons = sphere()
    return affine_weights(coarse, centre + radius * points), polygons
