"""The outline of a style moved to that of the hair in a photo, along rays from the middle of the head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.anatomy.hair.silhouette import Frame
from service.anatomy.hair.skull import CLEARANCE_M, EAR_M, REACH_M, Skull
from service.arrays import Float32, Float64, Int64

RAYS = 72
"""Directions in the picture in which outlines are compared."""
SMOOTH_RAYS = 2.0
"""Standard deviation, in rays, of the smoothing of their difference."""
LEAST_RAYS = 8
"""Fewest directions from which the thickness of hair is told."""
FARTHEST_M = (0.02, 0.035)
"""How far the outline is moved at most, inwards and outwards."""
SIDEWAYS_DEG = (95.0, 130.0)
"""Angle from upwards up to which outlines are matched, and from which on not at all: below, hair hangs."""
MIDDLE_M = (0.0, 0.0, -0.07)
"""Middle of the head, from which the rays go."""


def to_outline(
    points: Float64, skull: Skull, frame: Frame, mask: Float32, shown: Float32, known: Float32
) -> tuple[Float64, float]:
    """Points moved so that the outline of the style is that of the photo's hair, and their mean movement, metres.

    Args:
        points: (N, 3) of the style on the head, metres.
        skull: of the head.
        frame: of the photo.
        mask: (side, side) 1 where the style shows.
        shown: (side, side) in [0, 1], 1 where the photo shows hair.
        known: (side, side) in [0, 1], 0 beside the photo and where something hides what is there.
    """
    around = _Around.of(frame)
    if around is None:
        return points, 0.0
    centre, upwards, scale, cells_per_m = around.centre, around.upwards, around.scale, around.cells_per_m
    middle = np.array([MIDDLE_M])
    difference, reach = _differences(around, mask, shown, known)
    if not difference.any():
        return points, 0.0
    away = frame.place(frame.camera.project(points)) - centre
    length = np.linalg.norm(away, axis=1)
    turn = np.mod(np.arctan2(away[:, 1], away[:, 0]) - upwards, 2 * np.pi) / (2 * np.pi) * RAYS
    own, outer = (np.interp(turn, np.arange(RAYS + 1), np.append(row, row[0])) for row in (difference, reach))
    share = np.clip(length / np.maximum(outer, 1e-6), 0, 1.1) ** 2
    direction = away / np.maximum(length, 1e-6)[:, None]
    across = (direction * (own * share)[:, None]) @ np.linalg.inv(cells_per_m).T
    # What a photo from the front does not tell, the back of the head, is as full as the sides.
    top = _sideways(np.arange(RAYS)) > 0.5
    deep = frame.camera.to_camera(points)[:, 2] - frame.camera.to_camera(middle)[0, 2]
    behind = np.clip(deep / 0.1, 0, 1) ** 2 * (points[:, 1] > EAR_M) * float(difference[top].mean()) / scale
    offset = np.concatenate([across, behind[:, None]], 1) @ frame.camera.rotation
    moved = points + offset
    return off_skin(moved, skull), float(difference[top].mean()) / scale


def off_skin(points: Float64, skull: Skull) -> Float64:
    """(N, 3) points of which none is nearer the skin than hair is."""
    _, height, normal = skull.nearest(points)
    lower = (height < CLEARANCE_M) & (height > -REACH_M)
    return np.asarray(points + np.where(lower, CLEARANCE_M - height, 0.0)[:, None] * normal)


def thickness_mm(frame: Frame, shown: Float32, known: Float32) -> float | None:
    """How far the outline of the photo's hair stands off that of the bare head, median over the top and the sides.

    None where fewer than ``LEAST_RAYS`` tell. Arguments are those of :func:`to_outline`.
    """
    around = _Around.of(frame)
    if around is None:
        return None
    head = np.asarray(np.isfinite(frame.behind), np.float32)
    hair, bare, trust = _reaches(around, head, shown, known)
    told = trust > 0.5
    if told.sum() < LEAST_RAYS:
        return None
    return float(np.median((hair - bare)[told])) / around.scale * 1e3


@dataclass(frozen=True)
class _Around:
    """The middle of the head in a frame.

    Attributes:
        centre: (2,) cells.
        upwards: angle of the way up, radians.
        scale: cells a metre; cells_per_m: (2, 2) the same of the camera's axes.
    """

    centre: Float64
    upwards: float
    scale: float
    cells_per_m: Float64

    @classmethod
    def of(cls, frame: Frame) -> _Around | None:
        """None where the head has no size in the frame."""
        middle = np.array([MIDDLE_M])

        def at(point: Float64) -> Float64:
            return np.asarray(frame.place(frame.camera.project(point))[0], np.float64)

        centre = at(middle)
        cells_per_m = np.stack([(at(middle + 0.01 * axis) - centre) / 0.01 for axis in frame.camera.rotation[:2]], 1)
        area = abs(np.linalg.det(cells_per_m))
        if not area > 1e-6:
            return None
        up = at(middle + np.array([0.0, 0.05, 0.0])) - centre
        return cls(centre, float(np.arctan2(up[1], up[0])), float(np.sqrt(area)), cells_per_m)


def _reaches(around: _Around, mask: Float32, shown: Float32, known: Float32) -> tuple[Float64, Float64, Float64]:
    """(RAYS,) cells up to which the photo's hair and a silhouette reach, and how far the two can be compared."""
    side = mask.shape[0]
    radii = np.arange(1.0, 0.16 * around.scale, 0.5)
    angles = around.upwards + np.arange(RAYS) * 2 * np.pi / RAYS
    x, y = (around.centre[k] + np.outer(way, radii) for k, way in enumerate((np.cos(angles), np.sin(angles))))
    inside = (x >= 0) & (y >= 0) & (x < side) & (y < side)
    at = np.clip(y, 0, side - 1).astype(int), np.clip(x, 0, side - 1).astype(int)
    hair, style = (shown[at] > 0.5) & inside, (mask[at] > 0.5) & inside
    ends = [np.where(one.any(1), radii[one.shape[1] - 1 - np.argmax(one[:, ::-1], 1)], 0.0) for one in (hair, style)]
    # Hair that goes on beyond the photo, or behind something, does not tell where it ends.
    beyond = np.minimum(np.searchsorted(radii, ends[0] + 2.0), len(radii) - 1)
    sure = (known[at] > 0.5)[np.arange(RAYS), beyond] & inside[np.arange(RAYS), beyond]
    trust = sure * (ends[0] > 0) * (ends[1] > 0) * _sideways(np.arange(RAYS))
    return ends[0], ends[1], np.asarray(trust, np.float64)


def _differences(around: _Around, mask: Float32, shown: Float32, known: Float32) -> tuple[Float64, Float64]:
    """(RAYS,) cells by which the photo's hair reaches beyond the style's, smoothed, and how far the style's reaches."""
    hair, style, trust = _reaches(around, mask, shown, known)
    difference = np.clip(hair - style, -FARTHEST_M[0] * around.scale, FARTHEST_M[1] * around.scale)
    apart = np.minimum(np.arange(RAYS), RAYS - np.arange(RAYS))
    kernel = np.fft.rfft(np.exp(-0.5 * (apart / SMOOTH_RAYS) ** 2))
    summed, weight = (np.fft.irfft(np.fft.rfft(row) * kernel, RAYS) for row in (trust * difference, trust))
    return np.asarray(summed / (np.maximum(weight, 0) + 0.5)), np.maximum(style, 1.0)


def _sideways(rays: Int64 | Float64) -> Float64:
    """Weight of a ray by its angle from upwards."""
    turn = np.asarray(rays, np.float64) * (360.0 / RAYS)
    angle = np.abs(np.mod(turn + 180.0, 360.0) - 180.0)
    return np.asarray(np.clip((SIDEWAYS_DEG[1] - angle) / (SIDEWAYS_DEG[1] - SIDEWAYS_DEG[0]), 0, 1))
