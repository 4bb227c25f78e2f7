"""A style fitted to the hair that a photo shows: its outline moved, its hairline and its ends cut.

Ten styles are few, but most differ from somebody's hair in what a hairdresser would do: how far the hair stands off
the head, where it begins on the forehead, and how long it is. The first moves vertices along the rays from the middle
of the head, as the outline in the photo tells; the others cut triangles along lines of a field over the vertices
("marching triangles"), which is 0 where the photo shows skin, or nothing, where the style has hair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.anatomy.hair.wearables import CLEARANCE_M, EAR_M, REACH_M, Frame, Item, Skull
from service.arrays import Bool, Float32, Float64, Int32, Int64
from service.geometry.subdivide import clipped, split_in_four
from service.image_filters import blurred

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


def hair_thickness_mm(frame: Frame, shown: Float32, known: Float32) -> float | None:
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
    columns, triangles = split_in_four(columns, triangles, np.asarray(near > 1e-3))
    columns[:, :3] = _rooted(columns[:, :3], skull, frame, soft)
    for _ in range(SPLITS):
        columns, triangles = split_in_four(columns, triangles, _near_cut(field(columns), triangles))
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
    return blurred(np.asarray(image, np.float32), sigma)


def _near_cut(field: Float64, triangles: Int64) -> Bool:
    low, high = field[triangles].min(1), field[triangles].max(1)
    return np.asarray((low < 0.3) & (high > -0.3))
