"""An eyeball by the angle from its line of sight, and what the lids leave of the light on it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.eyeball import Eyeball
from service.geometry.chart import Chart

Float = npt.NDArray[np.float32]

LID_SHADE = ((-0.55, 0.75), (-0.30, 0.95), (-0.05, 1.0), (0.10, 0.87), (0.23, 0.55), (0.6, 0.4))
"""Height on the eyeball over its radius, and how much light the lids leave there, on sRGB values. Of the texture alone,
which has the photo's light in it."""
CORNER_SHADE = ((0.45, 1.0), (0.85, 0.75))
"""The same sideways, towards the corners of the lids."""
ALIKE = 0.45
"""RGB distance between photo and paint at which the photo counts for a third: far more is skin or a mirrored lamp."""


def paint_eye(angle: Float, limbus: float, pupil: float, sclera: Float, iris: Float, socket: Float) -> Float:
    """(N, 3) sRGB of an eyeball by the angle (N,) in degrees from its line of sight.

    Pupil, iris with a dark rim, sclera that reddens towards the socket.

    Args:
        angle: degrees.
        limbus: angle of the iris's rim.
        pupil: angle of the pupil's rim.
        sclera: (3,) sRGB.
        iris: (3,) sRGB.
        socket: (3,) sRGB.
    """
    colour = np.broadcast_to(iris, (len(angle), 3)) * (1 + 0.25 * _blend(angle, 0.9 * limbus, 0.4 * limbus))
    colour = colour * (1 - 0.45 * _blend(angle, 0.82 * limbus, limbus))
    colour = colour * (1 - 0.85 * _blend(angle, 1.15 * pupil, 0.9 * pupil))
    pale = sclera + (socket - sclera) * (0.9 * _blend(angle, 1.6 * limbus, 4.0 * limbus))
    return np.asarray(np.clip(colour + (pale - colour) * _blend(angle, 0.94 * limbus, 1.1 * limbus), 0, 1), np.float32)


def _blend(value: Float, low: float, high: float) -> Float:
    """Smoothstep of (N,) as (N, 1)."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray((t * t * (3 - 2 * t))[:, None], np.float32)


def on_eyeball(chart: Chart, part: int) -> tuple[Eyeball, npt.NDArray[np.float64]]:
    """The eyeball that a part is in the neutral mean head, and the points (n, 3) of its inner texels, metres."""
    head = chart.head
    texels = np.flatnonzero(chart.inner_part == part)
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]])
    return Eyeball.of(head.mean[np.unique(head.triangles[head.triangle_part == part])]), points


def sight_angle(ball: Eyeball, points: npt.NDArray[np.floating]) -> Float:
    """(n,) degrees between points (n, 3) and the line of sight, which is +Z in the neutral head."""
    return np.asarray(np.degrees(np.arccos(np.clip(ball.rays(points)[:, 2], -1.0, 1.0))), np.float32)


def lid_shade(ball: Eyeball, points: npt.NDArray[np.floating]) -> Float:
    """(n, 1) light that the lids leave to points (n, 3) of an eyeball, a factor on sRGB values."""
    x, y, _ = (points - ball.centre).T / max(ball.radius, 1e-6)
    lids, corners = np.array(LID_SHADE).T, np.array(CORNER_SHADE).T
    return np.asarray(np.interp(y, *lids) * np.interp(np.abs(x), *corners), np.float32)[:, None]


def alike(seen: Float, painted: Float) -> Float:
    """(n,) in [0, 1] how well colours (n, 3) of the photo agree with the painted ones."""
    distance = ((seen - painted) ** 2).sum(1)
    return np.asarray(np.exp(-distance / ALIKE**2), np.float32)
