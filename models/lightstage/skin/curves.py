"""Lines drawn as chains of short segments: wrinkles, hairs, vessels, scars."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.splat import Marks, Stamp

Float = npt.NDArray[np.float64]

OWN_VALUES = 3
"""Leading values of a segment: half length (mm), cos and sin of its direction; the drawer's own follow."""


def smooth_curve(points: Float, count: int) -> Float:
    """(count, D) points evenly along the Catmull-Rom spline through (N, D) points, N >= 2."""
    padded = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
    t = np.linspace(0.0, len(points) - 1.0, count)
    k = np.minimum(t.astype(int), len(points) - 2)
    s = (t - k)[:, None]
    a, b, c, d = (padded[k + i] for i in range(4))
    return np.asarray(0.5 * (2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3))


def segments(anatomy: Anatomy, uv: Float, values: Float, reach_mm: Float | float) -> Marks:
    """Marks for the pieces of one or many curves.

    Args:
        anatomy: gives the frames.
        uv: (C, P, 2) chart coordinates of the points of C curves.
        values: (C, P - 1, K) of each piece, for the drawer.
        reach_mm: how far from the line it is drawn; a number or (C, P - 1).
    """
    start, end = uv[:, :-1].reshape(-1, 2), uv[:, 1:].reshape(-1, 2)
    middle = 0.5 * (start + end)
    frame = anatomy.atlas.frames(middle)
    step = end - start
    a = frame[:, 0] * step[:, 0] + frame[:, 1] * step[:, 1]
    b = frame[:, 2] * step[:, 1]
    length = np.maximum(np.hypot(a, b), 1e-6)
    own = np.stack([0.5 * length, a / length, b / length], 1)
    reach = np.broadcast_to(np.asarray(reach_mm, np.float64), uv[:, :-1, 0].shape).reshape(-1)
    return Marks(
        middle, frame, 0.5 * length + reach, np.concatenate([own, values.reshape(len(own), values.shape[-1])], 1)
    )


def grown(anatomy: Anatomy, root: Float, angle: Float, turn: Float, length_mm: Float, pieces: int) -> Float:
    """(N, pieces + 1, 2) chart coordinates of curves from (N, 2) that bend by ``turn`` radians over their length.

    The frame at the root serves the whole curve, which is short against the curvature of the chart.
    """
    frame = anatomy.atlas.frames(root)
    points = [root]
    for i in range(pieces):
        direction = angle + turn * (i + 0.5) / pieces
        a = np.cos(direction) * length_mm / pieces
        b = np.sin(direction) * length_mm / pieces
        dv = b / frame[:, 2]
        du = (a - frame[:, 1] * dv) / frame[:, 0]
        points.append(points[-1] + np.stack([du, dv], 1))
    return np.stack(points, 1)


def distance(stamp: Stamp) -> tuple[Tensor, Tensor]:
    """(M,) signed distance (mm) across the segment's line, and distance to the segment itself."""
    half, cos, sin = stamp.values[:OWN_VALUES]
    along = stamp.a * cos + stamp.b * sin
    across = -stamp.a * sin + stamp.b * cos
    beyond = (along.abs() - half).clamp(min=0.0)
    return across, (across * across + beyond * beyond).sqrt()


def coverage(away: Tensor, width_mm: Tensor, size_mm: Tensor) -> Tensor:
    """Share of a texel that a line of some width covers, for the distance of its centre from the line."""
    reach = 0.5 * (width_mm + size_mm)
    return ((reach - away) / torch.minimum(width_mm, size_mm).clamp(min=1e-4)).clamp(0.0, 1.0) * (
        width_mm / size_mm
    ).clamp(max=1.0)
