"""A style fitted to the hair that a photo shows: its outline moved, its hairline and its ends cut.

Ten styles are few, but most differ from somebody's hair in what a hairdresser would do: how far the hair stands off
the head, where it begins on the forehead, and how long it is. The first moves vertices along the rays from the middle
of the head, as the outline in the photo tells; the others cut triangles along lines of a field over the vertices
("marching triangles"), which is 0 where the photo shows skin, or nothing, where the style has hair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.anatomy.hair.item import Item
from service.anatomy.hair.outline import off_skin, to_outline
from service.anatomy.hair.silhouette import Frame
from service.anatomy.hair.skull import CLEARANCE_M, EAR_M, Skull
from service.arrays import Bool, Float32, Float64, Int32, Int64
from service.geometry.cutting import clipped, split

UNEVEN, UNEVEN_ENDS = 0.15, 0.4
"""Amplitude of the field's unevenness from strand to strand, at the hairline and at cut ends: neither is an edge."""
STRANDS = 90.0
"""Strands over the width of a texture, about."""
ENDS_M = 0.02
"""Length over which strands end at a cut."""
STEP_M = 0.01
LEAST_POINTS = 6
GONE = 0.12
"""Hair is cut where in all steps of ``STEP_M`` below less than this share of the style's is seen in the photo, among
steps with so many vertices that the photo would show."""
SOFT_CELLS = 1.0
"""Standard deviation of the blur of where the photo shows no hair, cells of the frame, before it is cut along."""
ROOTED_CELLS = 7.0
"""The same of how near to the hairline hair lies on the skin."""
ROOTED_M = (0.01, 0.035)
"""Height over the eyes from which on hair at the border is rooted there, from 0 to 1; below, it hangs over the face."""
LEAST_LEFT = 0.1
"""Share of a style's triangles that cutting has to leave; else nothing is cut."""
SPLITS = 1
"""How often triangles at a cut are split in four before it."""


@dataclass(frozen=True)
class Tailored:
    """A style as it is worn.

    Attributes:
        points: (N, 3) float32 metres, head space.
        uv: (N, 2) float32.
        triangles: (T, 3) int32.
        ends_m: height, head space, at which hanging hair was cut; None where it was not.
        wider_m: mean movement of the outline, metres.
    """

    points: Float32
    uv: Float32
    triangles: Int32
    ends_m: float | None
    wider_m: float


def tailored(item: Item, points: Float32, skull: Skull, frame: Frame, shown: Float32, known: Float32) -> Tailored:
    """Fit a style.

    Args:
        item: the style, as it is worn (mirrored or not).
        points: (N, 3) its vertices on the head.
        skull: of the head.
        frame: of the photo.
        shown: (side, side) in [0, 1], 1 where the photo shows hair.
        known: (side, side) in [0, 1], 0 beside the photo and where something hides what is there.
    """
    mask, _ = frame.hair(item, points)
    moved, wider = to_outline(points.astype(np.float64), skull, frame, mask, shown, known)
    # Hair is where the photo shows it but for a cell: its border is soft.
    free = known * (1 - shown) * np.isfinite(frame.behind)
    bare = np.asarray(_blurred(free, SOFT_CELLS), np.float64)
    ends = _ends(moved, frame, shown, known)

    def field(columns: Float64) -> Float64:
        """Above 0 where hair stays."""
        hairline, strands = _hairline(columns[:, :3], frame, bare), _strands(columns[:, 3:5])
        stays = hairline + UNEVEN * strands * (hairline < 0.45)
        if ends is None:
            return np.asarray(stays)
        return np.minimum(stays, (columns[:, 1] - ends) / ENDS_M + UNEVEN_ENDS * strands)

    columns, triangles = np.concatenate([moved, item.uv], 1), item.triangles.astype(np.int64)
    # Split first where it is moved, and beyond: what is split along still edges has no cracks.
    soft = np.asarray(_blurred(free, ROOTED_CELLS), np.float64)
    near = _nearness(columns[:, :3], frame, soft)[triangles].max(1)
    columns, triangles = split(columns, triangles, np.asarray(near > 1e-3))
    columns[:, :3] = _rooted(columns[:, :3], skull, frame, soft)
    for _ in range(SPLITS):
        columns, triangles = split(columns, triangles, _near_cut(field(columns), triangles))
    cut, left = clipped(columns, triangles, field(columns))
    if len(left) < LEAST_LEFT * len(triangles):
        cut, left, ends = columns, triangles, None  # this photo has no such hair at all
    columns, triangles = cut, left
    f = np.float32
    own = off_skin(columns[:, :3], skull).astype(f)
    return Tailored(own, columns[:, 3:5].astype(f), triangles.astype(np.int32), ends, float(wider))


# --- Cuts -------------------------------------------------------------------------------------------------------------


def _hairline(points: Float64, frame: Frame, bare: Float64) -> Float64:
    """(N,) 0.5 where hair stays, below 0 where the photo shows skin instead; the unseen side is as the seen one.

    That holds above the eyes only: hair that is put behind one ear may hang over the other.
    """
    own, sees = _cover(points, frame, bare)
    other, other_sees = _cover(points * [-1, 1, 1], frame, bare)
    return np.asarray(0.5 - np.where(sees, own, np.where(other_sees, other * _above_eyes(points), 0.0)))


def _rooted(points: Float64, skull: Skull, frame: Frame, soft: Float64) -> Float64:
    """Points whose height above the skin falls towards the photo's hairline, where what is left of a fringe begins."""
    _, height, normal = skull.nearest(points)
    lower = -_nearness(points, frame, soft) * np.maximum(height - CLEARANCE_M, 0.0)
    return np.asarray(points + lower[:, None] * normal)


def _nearness(points: Float64, frame: Frame, soft: Float64) -> Float64:
    """(N,) 1 at the hairline and where no hair is, falling to 0 over ``ROOTED_CELLS``; 0 at the sides of the face."""
    own, sees = _cover(points, frame, soft)
    other, other_sees = _cover(points * [-1, 1, 1], frame, soft)
    near = np.clip(2 * np.where(sees, own, np.where(other_sees, other, 0.0)), 0, 1)
    return np.asarray(near * _above_eyes(points))


def _above_eyes(points: Float64) -> Float64:
    """(N,) 0 to 1 over ``ROOTED_M``."""
    return np.asarray(np.clip((points[:, 1] - ROOTED_M[0]) / (ROOTED_M[1] - ROOTED_M[0]), 0, 1))


def _cover(points: Float64, frame: Frame, bare: Float64) -> tuple[Float64, Bool]:
    """The picture's value at points, and whether they stand before the head there."""
    flat, depth = frame.place(frame.camera.project(points)), frame.camera.to_camera(points)[:, 2]
    at, inside = _cells(flat, frame.side)
    return np.asarray(bare[at] * inside), np.asarray(inside & (depth < frame.behind[at] + 0.004))


def _ends(points: Float64, frame: Frame, shown: Float32, known: Float32) -> float | None:
    """Height at which the photo's hair ends, of hair that hangs below the ears; None where it does not tell."""
    flat, depth = frame.place(frame.camera.project(points)), frame.camera.to_camera(points)[:, 2]
    at, inside = _cells(flat, frame.side)
    soft = _blurred(shown, 1.0)
    tells = inside & (known[at] > 0.5) & (depth < frame.behind[at] + 0.004) & (points[:, 1] < EAR_M)
    step = np.floor((EAR_M - points[tells, 1]) / STEP_M).astype(int)
    if not len(step):
        return None
    count = np.bincount(step)
    seen = np.bincount(step, np.minimum(2 * soft[at][tells], 1))
    share = np.where(count >= LEAST_POINTS, seen / np.maximum(count, 1), np.nan)
    told = np.flatnonzero(~np.isnan(share))
    gone = [k for k in told if (share[told[told >= k]] < GONE).all()]
    return float(EAR_M - STEP_M * gone[0]) if gone else None


def _cells(flat: Float64, side: int) -> tuple[tuple[Int64, Int64], Bool]:
    inside = ((flat >= 0) & (flat < side)).all(1)
    clipped_to = np.clip(np.nan_to_num(flat), 0, side - 1).astype(np.int64)
    return (clipped_to[:, 1], clipped_to[:, 0]), np.asarray(inside)


def _strands(uv: Float64 | Float32) -> Float64:
    """(N,) in [-1, 1], even along strands and uneven across: they run along v."""
    across = np.asarray(uv[:, 0], np.float64) * STRANDS
    return np.asarray(np.sin(across * 2.1) * np.sin(across * 0.73 + 1.3))


def _blurred(image: Float32, sigma: float) -> Float32:
    import cv2

    return np.asarray(cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), sigma), np.float32)


def _near_cut(field: Float64, triangles: Int64) -> Bool:
    low, high = field[triangles].min(1), field[triangles].max(1)
    return np.asarray((low < 0.3) & (high > -0.3))
