"""Initial pose from landmarks: weak perspective in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float64
from service.geometry.rotation import nearest_rotation


@dataclass(frozen=True)
class WeakPose:
    """Scaled orthographic pose: pixel = scale * (rotation @ X)[:2] + offset.

    Attributes:
        rotation: (3, 3), camera axes x right, y down, z forward.
        scale: pixels per metre, > 0.
        offset: (2,) pixels.
    """

    rotation: Float64
    scale: float
    offset: Float64


def weak_pose(points: Float64, pixels: Float64, weights: Float64) -> WeakPose:
    """Least-squares scaled orthographic pose.

    Args:
        points: (N, 3) metres, head space.
        pixels: (N, 2).
        weights: (N,) >= 0, at least one positive.

    Returns:
        The pose; where the points do not determine it (fewer than four, or all on one line) an upright frontal one
        at the scale that the spread of the pixels suggests.
    """
    w = weights / max(float(weights.sum()), 1e-12)
    centre, middle = w @ points, w @ pixels
    x, u = points - centre, pixels - middle
    spread_x = float(np.sqrt((w[:, None] * x**2).sum()))
    spread_u = float(np.sqrt((w[:, None] * u**2).sum()))
    scale = max(spread_u, 1e-6) / max(spread_x, 1e-6)
    rotation = np.diag([1.0, -1.0, -1.0])
    moment = x.T @ (w[:, None] * x)
    if np.linalg.eigvalsh(moment)[0] > 1e-10:
        m = (np.linalg.solve(moment, x.T @ (w[:, None] * u))).T
        candidate_scale = float(np.linalg.norm(m, axis=1).mean())
        if candidate_scale > 1e-6:
            scale = candidate_scale
            unit = m / scale
            rotation = nearest_rotation(np.vstack([unit, np.cross(unit[0], unit[1])]))
    return WeakPose(rotation, scale, middle - scale * (rotation @ centre)[:2])
