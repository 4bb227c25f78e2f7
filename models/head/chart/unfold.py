"""Unfold one island: wanted scale, closed holes, convex start, least distortion."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.head.chart.flatten import Patch, boundary_loop, minimise, rest_frames, tutte
from models.head.chart.islands import Island
from models.head.chart.layout import HEIGHT, Flat, walls
from models.head.crop import Crop

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

FACE_PPM, REST_PPM, NECK_PPM = 20.0, 9.0, 7.5
"""Wanted pixels per mm on the face, on the rest of the head and on the neck; flattening brings the face to about 15."""
WALL_STRENGTH = 0.02
SEAM_FRONT = (-12.0, -110.0)
"""z (mm) from which the midline is kept whole, above and below the eyes; behind it the chart is cut open."""


def _smooth(value: Float, low: float, high: float) -> Float:
    t = np.clip((value - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def wanted_ppm(points_mm: Float) -> Float:
    """(N,) wanted pixels per mm at (N, 3) points of the template in mm (origin between the eyes).

    The full scale holds within 60 degrees of the front and between chin and hairline and fades to the back.
    """
    angle = np.degrees(np.abs(np.arctan2(points_mm[:, 0], points_mm[:, 2] + 95.0)))
    front = 1 - _smooth(angle, 45.0, 115.0)
    below = _smooth(points_mm[:, 1] + 0.35 * points_mm[:, 2], -160.0, -90.0)
    above = 1 - _smooth(points_mm[:, 1], 60.0, 125.0)
    rest = NECK_PPM + (REST_PPM - NECK_PPM) * _smooth(points_mm[:, 1], -150.0, -60.0)
    return np.asarray(rest + (FACE_PPM - rest) * front * below * above)


def _triangles(corners: Int) -> Int:
    quad = corners[:, 3] >= 0
    return np.concatenate([corners[:, [0, 1, 2]], corners[quad][:, [0, 2, 3]]])


def _loops(triangles: Int) -> list[Int]:
    """All boundary loops, counter-clockwise round the patch."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    table = {(int(a), int(b)) for a, b in sides}
    follow = {a: b for a, b in table if (b, a) not in table}
    loops = []
    while follow:
        loop = [min(follow)]
        while follow[loop[-1]] != loop[0]:
            loop.append(follow[loop[-1]])
        for v in loop:
            del follow[v]
        loops.append(np.array(loop))
    return loops


def _openings(triangles: Int, points: Float, pinned: npt.NDArray[np.bool_]) -> tuple[list[Int], list[bool]]:
    """Edge runs round the openings of the half face, and whether each lies on the midline.

    The eye is a loop of its own (closed here by repeating its first vertex); half the mouth is a run of the outer
    boundary that leaves the midline in front and comes back to it.
    """
    loops = _loops(triangles)
    outer = max(loops, key=len)
    runs = [np.append(loop, loop[0]) for loop in loops if loop is not outer]
    on_midline = [False] * len(runs)
    start = int(np.flatnonzero(pinned[outer])[0])
    ordered = np.roll(outer, -start)
    on = np.flatnonzero(pinned[ordered])
    for jump in np.flatnonzero(np.diff(on) > 1):
        run = ordered[on[jump] : on[jump + 1] + 1]
        if points[run, 2].min() > points[:, 2].max() - 60.0:
            runs.append(run)
            on_midline.append(True)
    return runs, on_midline


def _border(points: Float, boundary: Int, pinned: npt.NDArray[np.bool_]) -> Float:
    """Convex start: the pinned run on a vertical line, the rest on half an ellipse; without pins, a circle."""
    step = np.linalg.norm(points[np.roll(boundary, -1)] - points[boundary], axis=1) + 1e-6
    if not pinned.any():
        angle = 2 * np.pi * np.concatenate([[0], np.cumsum(step)[:-1]]) / step.sum()
        return np.stack([np.cos(angle), np.sin(angle)], 1)
    on = pinned[boundary]
    start = int(np.flatnonzero(on & ~np.roll(on, 1))[0])
    order = np.roll(np.arange(len(boundary)), -start)
    on, step = on[order], step[order]
    count = int(on.sum())
    down = np.concatenate([[0], np.cumsum(step[: count - 1])])
    y = 1 - 2 * down / down[-1]
    round_ = np.cumsum(step[count - 1 :])[:-1] / step[count - 1 :].sum() * np.pi
    xy = np.concatenate([np.stack([np.zeros(count), y], 1), np.stack([np.sin(round_), -np.cos(round_)], 1)])
    out = np.zeros_like(xy)
    out[order] = xy
    return out


def unfold_small(crop: Crop, template_mm: Float, island: Island, ppm: float) -> Flat:
    """Lay a small island flat at ``ppm`` pixels per mm, free of walls and pins; template_mm is (V, 3)."""
    corners, points, triangles = _local(crop, template_mm, island)
    rest = rest_frames(points[triangles], np.full(len(triangles), ppm))
    area = 0.5 * np.linalg.det(rest)
    boundary, nothing = boundary_loop(triangles), np.zeros(len(points), bool)
    patch = Patch(triangles, rest, area / area.sum(), boundary, np.zeros(0, np.int64), np.zeros((0, 3)), 0.0)
    start = tutte(patch, _border(points, boundary, nothing)) * np.sqrt(area.sum() / np.pi)
    return Flat(island.name, island.polygons, corners, minimise(patch, start), nothing)


def unfold_face(crop: Crop, template_mm: Float, island: Island) -> Flat:
    """Lay the half of the seen skin flat inside its room, the front midline straight on x = 0; template_mm is (V, 3).

    Eye and mouth are closed by fans of almost weightless triangles, so that their rims cannot fold over.
    """
    corners, points, triangles = _local(crop, template_mm, island)
    above, below = SEAM_FRONT
    pinned = (np.abs(points[:, 0]) < 1e-6) & (points[:, 2] > np.where(points[:, 1] > 0, above, below))
    rest = rest_frames(points[triangles], wanted_ppm(points[triangles].mean(1)))
    area = 0.5 * np.linalg.det(rest)
    weight = area / area.sum()
    runs, on_midline = _openings(triangles, points, pinned)
    centres = len(points) + np.arange(len(runs))
    fan = np.concatenate(
        [np.stack([r[1:], r[:-1], np.full(len(r) - 1, c)], 1) for r, c in zip(runs, centres, strict=True)]
    )
    length = np.linalg.norm(points[fan[:, 0]] - points[fan[:, 1]], axis=1)
    shape = np.zeros((len(fan), 2, 2))  # isosceles triangles, 8 mm high
    shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1] = length, length / 2, 8.0
    closed = np.concatenate([triangles, fan])
    all_points = np.concatenate([points, [points[run].mean(0) for run in runs]])
    all_pinned = np.concatenate([pinned, on_midline])
    boundary = boundary_loop(closed)
    patch = Patch(
        closed,
        np.concatenate([rest, shape * FACE_PPM]),
        np.concatenate([weight, np.full(len(fan), 1e-6)]),
        boundary,
        np.flatnonzero(all_pinned),
        walls(),
        WALL_STRENGTH,
    )
    start = tutte(patch, _border(all_points, boundary, all_pinned))
    start = start * np.array([1400.0, 1550.0]) / np.abs(start).max(0) + np.array([0.0, HEIGHT / 2 + 250.0])
    xy = minimise(patch, start, iterations=1500)
    return Flat(island.name, island.polygons, corners, xy[: len(points)], pinned)


def _local(crop: Crop, template_mm: Float, island: Island) -> tuple[Int, Float, Int]:
    """The island's polygons, points and triangles in its own numbering."""
    table = crop.polygons[island.polygons]
    used = np.unique(table[table >= 0])
    corners = np.where(table < 0, -1, np.searchsorted(used, table))
    return corners, template_mm[used], _triangles(corners)
