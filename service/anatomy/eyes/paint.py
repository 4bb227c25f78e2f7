"""Colour of an eyeball by the angle from its line of sight, and the shade of the lids on it."""

from __future__ import annotations

import numpy as np

from service.anatomy.eyes.eyeball import Eyeball
from service.arrays import AnyFloat, Float32, Float64
from service.geometry.chart import Chart

LID_SHADE = ((-0.55, 0.75), (-0.30, 0.95), (-0.05, 1.0), (0.10, 0.87), (0.23, 0.55), (0.6, 0.4))
"""Pairs of height on the eyeball over its radius, and the factor of the lids' shade there on sRGB values. For the
texture only, which has the photo's light baked in."""

CORNER_SHADE = ((0.45, 1.0), (0.85, 0.75))
"""The same by horizontal distance over the radius, towards the corners of the lids."""


def paint_eye(angle: Float32, limbus: float, pupil: float, sclera: Float32, iris: Float32, socket: Float32) -> Float32:
    """(N, 3) sRGB of an eyeball by the angle (N,) in degrees from its line of sight.

    Pupil, iris with a dark limbus, sclera that reddens towards the socket.

    Args:
        angle: (N,) degrees.
        limbus: angle of the iris's rim, degrees.
        pupil: angle of the pupil's rim, degrees.
        sclera: (3,) sRGB.
        iris: (3,) sRGB.
        socket: (3,) sRGB.
    """
    colour = np.broadcast_to(iris, (len(angle), 3)) * (1 + 0.25 * _blend(angle, 0.9 * limbus, 0.4 * limbus))
    colour = colour * (1 - 0.45 * _blend(angle, 0.82 * limbus, limbus))
    colour = colour * (1 - 0.85 * _blend(angle, 1.15 * pupil, 0.9 * pupil))
    pale = sclera + (socket - sclera) * (0.9 * _blend(angle, 1.6 * limbus, 4.0 * limbus))
    return np.asarray(np.clip(colour + (pale - colour) * _blend(angle, 0.94 * limbus, 1.1 * limbus), 0, 1), np.float32)


def _blend(value: Float32, low: float, high: float) -> Float32:
    """:func:`smoothstep` of (N,) as (N, 1)."""
    return smoothstep(value, low, high)[:, None]


def smoothstep(value: Float32, low: float, high: float) -> Float32:
    """Cubic ramp of values of any shape, from 0 at ``low`` to 1 at ``high``, which may be less than ``low``."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def on_eyeball(chart: Chart, part: int) -> tuple[Eyeball, Float64]:
    """The eyeball of a part of the neutral mean head, and points (n, 3) float64 of its inner texels, metres."""
    head = chart.head
    texels = np.flatnonzero(chart.inner_part == part)
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]])
    return Eyeball.of(head.mean[np.unique(head.triangles[head.triangle_part == part])]), points


def sight_angle(ball: Eyeball, points: AnyFloat) -> Float32:
    """(n,) degrees between the line of sight, +Z in the neutral head, and the directions of points (n, 3)."""
    return np.asarray(np.degrees(np.arccos(np.clip(ball.rays(points)[:, 2], -1.0, 1.0))), np.float32)


def lid_shade(ball: Eyeball, points: AnyFloat) -> Float32:
    """(n, 1) factor on sRGB values by which the lids shade points (n, 3) of an eyeball."""
    x, y, _ = (points - ball.centre).T / max(ball.radius, 1e-6)
    lids, corners = np.array(LID_SHADE).T, np.array(CORNER_SHADE).T
    return np.asarray(np.interp(y, *lids) * np.interp(np.abs(x), *corners), np.float32)[:, None]
