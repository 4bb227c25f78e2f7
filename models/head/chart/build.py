"""Make the chart: lay every left island flat, place it in the right half of the image, mirror."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.chart.flatten import Patch, boundary_loop, minimise, rest_frames, tutte
from models.head.chart.islands import Island, cut, left_polygons
from models.head.crop import PART_NAMES, Crop
from models.head.eyes import RINGS_DEG, SEGMENTS
from models.head.source import BaseMesh

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

WIDTH, HEIGHT = 6144, 4096
"""Pixels of the full-size image; the chart is laid out in these so that texels are square."""
MARGIN = 10.0
"""Pixels kept free on each side of an island: at least 20 between two of them."""
CORNER = ((1450.0, 0.0), (WIDTH / 2, 720.0))
"""Line, in pixels from the midline, that cuts off the corner for everything that is not seen skin."""
FACE_PPM, REST_PPM, NECK_PPM = 20.0, 9.0, 7.5
"""Wanted pixels per mm on the face, on the rest of the head and on the neck; flattening brings the face to about 15."""
SEAM_FRONT = (5.0, -110.0)
"""z (mm) from which the midline is kept whole, above and below the eyes; behind it the chart is cut open."""
SMALL_PPM = {"mouth": 1.9, "socket": 2.4, "teeth_upper": 4.5, "teeth_lower": 4.5, "tongue": 2.6}
EYE_RADIUS = 135.0


@dataclass(frozen=True)
class Chart:
    """uv: (U, 2) float64 in [0, 1], origin bottom left; polygon_uv: (Q, 4) int64, -1 pads triangles."""

    uv: Float
    polygon_uv: Int


@dataclass
class Flat:
    """One island laid flat: polygons of the left half, their corners (Q, 4) into xy (N, 2) pixels; x = 0 is the midline."""

    name: str
    polygons: Int
    corners: Int
    xy: Float
    on_midline: npt.NDArray[np.bool_]


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


def _fans(triangles: Int, points: Float, middle: npt.NDArray[np.bool_], seam: Int) -> tuple[Int, Int]:
    """Triangles that close the holes (eye, half mouth) around new vertices, and those new vertices on the midline."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    table = {(int(a), int(b)) for a, b in sides}
    follow = {a: b for a, b in table if (b, a) not in table}
    loops = []
    while follow:
        start = min(follow)
        loop = [start]
        while follow[loop[-1]] != start:
            loop.append(follow[loop[-1]])
        for v in loop:
            del follow[v]
        loops.append(np.array(loop))
    outer = max(range(len(loops)), key=lambda k: len(loops[k]))
    new, fan = len(points), []
    added = []
    for k, loop in enumerate(loops):
        if k != outer:
            fan.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), new)], 1))
            new += 1
            continue
        # the mouth: a run of the outer boundary that leaves the midline and comes back to it in front
        position = {int(v): i for i, v in enumerate(loop)}
        if not len(seam):
            continue
        ordered = np.roll(loop, -position[int(seam[0])])
        ahead = np.flatnonzero(middle[ordered])
        jumps = np.flatnonzero(np.diff(ahead) > 1)
        for jump in jumps:
            run = ordered[ahead[jump] : ahead[jump + 1] + 1]
            if points[run, 2].min() > points[:, 2].max() - 60.0:
                fan.append(np.stack([run[1:], run[:-1], np.full(len(run) - 1, new)], 1))
                added.append(new)
                new += 1
    return (np.concatenate(fan) if fan else np.zeros((0, 3), np.int64)), np.array(added, np.int64)


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
    xy = np.concatenate(
        [np.stack([np.zeros(count), y], 1), np.stack([np.sin(round_), -np.cos(round_)], 1)]
    )
    out = np.zeros_like(xy)
    out[order] = xy
    return out


def flatten(crop: Crop, template_mm: Float, island: Island, ppm: float | None) -> Flat:
    """Lay one island flat.

    Args:
        crop: the head.
        template_mm: (V, 3) template in mm.
        island: polygons of the left half.
        ppm: pixels per mm, or None for ``wanted_ppm``.
    """
    table = crop.polygons[island.polygons]
    used = np.unique(table[table >= 0])
    corners = np.where(table < 0, -1, np.searchsorted(used, table))
    points = template_mm[used]
    triangles = _triangles(corners)
    middle = np.abs(points[:, 0]) < 1e-6
    above, below = SEAM_FRONT
    kept = points[:, 2] > np.where(points[:, 1] > 0, above, below)
    pinned = middle & kept & (island.name == "face")
    fan, added = (
        _fans(triangles, points, pinned, np.flatnonzero(pinned)[:1]) if island.name == "face" else (np.zeros((0, 3), int), np.zeros(0, int))
    )
    scale = wanted_ppm(points[triangles].mean(1)) if ppm is None else np.full(len(triangles), ppm)
    rest = rest_frames(points[triangles], scale)
    area = 0.5 * np.abs(np.linalg.det(rest))
    weight = area / area.sum()
    all_points, all_triangles, all_pinned = points, triangles, pinned
    if len(fan):
        length = np.linalg.norm(points[fan[:, 0]] - points[fan[:, 1]], axis=1)
        isosceles = np.stack([np.stack([length, length / 2], 1), np.stack([np.zeros_like(length), np.full_like(length, 8.0)], 1)], 1)
        rest = np.concatenate([rest, isosceles * FACE_PPM])
        weight = np.concatenate([weight, np.full(len(fan), 1e-6 * weight.sum())])
        all_triangles = np.concatenate([triangles, fan])
        centres = [points[np.unique(fan[fan[:, 2] == v][:, :2])].mean(0) for v in np.unique(fan[:, 2])]
        all_points = np.concatenate([points, centres])
        all_pinned = np.zeros(len(all_points), bool)
        all_pinned[: len(points)] = pinned
        all_pinned[added] = True
    boundary = boundary_loop(all_triangles)
    walls = _walls() if island.name == "face" else np.zeros((0, 3))
    patch = Patch(all_triangles, rest, weight, boundary, np.flatnonzero(all_pinned), walls, 0.02)
    start = tutte(patch, _border(all_points, boundary, all_pinned)) * np.sqrt(area.sum() / np.pi)
    if island.name == "face":
        start *= np.array([1400.0, 1550.0]) / np.abs(start).max(0)
        start[:, 1] += HEIGHT / 2 + 250.0
    xy = minimise(patch, start, iterations=1500 if island.name == "face" else 400)
    return Flat(island.name, island.polygons, corners, xy[: len(points)], pinned)


def _walls() -> Float:
    """The right half of the image without its lower corner; the midline itself is kept by pins."""
    (x0, y0), (x1, y1) = CORNER
    length = np.hypot(x1 - x0, y1 - y0)
    a, b = (y0 - y1) / length, (x1 - x0) / length
    return np.array(
        [
            [-1.0, 0.0, WIDTH / 2 - MARGIN],
            [0.0, 1.0, -MARGIN],
            [0.0, -1.0, HEIGHT - MARGIN],
            [a, b, -(a * x0 + b * y0) - MARGIN],
        ]
    )


def eye_disc(crop: Crop, part: int, polygons: Int, radius: float) -> Flat:
    """The eyeball as a disc, equidistant from the line of sight; the back pole becomes the rim."""
    corners = crop.polygons[polygons]
    first = int(np.unique(corners[corners >= 0])[0])
    local = np.where(corners < 0, -1, corners - first)
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    rings = [np.zeros((1, 2))]
    for theta in RINGS_DEG:
        rings.append(radius * theta / 180 * np.stack([np.cos(angle), np.sin(angle)], 1))
    between = angle + np.pi / SEGMENTS
    rings.append(radius * np.stack([np.cos(between), np.sin(between)], 1))
    last = 1 + len(RINGS_DEG) * SEGMENTS
    out = local.copy()
    for row in np.flatnonzero((local == last).any(1)):  # each triangle at the back pole gets its own rim point
        a = local[row, 2]  # (pole, after, here): the rim point beside "here"
        out[row, 0] = last + (a - (1 + (len(RINGS_DEG) - 1) * SEGMENTS))
    return Flat(PART_NAMES[part], polygons, out, np.concatenate(rings), np.zeros(last + SEGMENTS, bool))


def _upright(flat: Flat) -> None:
    """Turn a free island so that its bounding box is flat and wide, then move its corner to the origin."""
    best = min(
        np.radians(np.arange(0, 180, 3.0)),
        key=lambda a: np.ptp(flat.xy @ np.array([-np.sin(a), np.cos(a)])),
    )
    c, s = np.cos(best), np.sin(best)
    flat.xy = flat.xy @ np.array([[c, -s], [s, c]])
    flat.xy -= flat.xy.min(0)


def place(flats: list[Flat]) -> None:
    """Move the small islands into the lower right corner: tallest first, each as low and as far right as it fits.

    Raises:
        ValueError: an island does not fit.
    """
    (x0, y0), (x1, y1) = CORNER
    taken: list[tuple[float, float, float, float]] = []
    small = [flat for flat in flats if flat.name != "face"]
    for flat in sorted(small, key=lambda f: -float(np.ptp(f.xy[:, 1]))):
        width, height = np.ptp(flat.xy, axis=0) + 2 * MARGIN
        spot = None
        for y in np.arange(0.0, y1, 4.0):
            for x in np.arange(WIDTH / 2 - width, x0, -4.0):
                ceiling = y0 + (y1 - y0) * (x - x0) / (x1 - x0)
                free = all(x >= c or x + width <= a or y >= d or y + height <= b for a, b, c, d in taken)
                if y + height <= ceiling and free:
                    spot = (x, y)
                    break
            if spot:
                break
        if spot is None:
            raise ValueError(f"no room for island {flat.name} of {width:.0f} x {height:.0f} pixels")
        taken.append((spot[0], spot[1], spot[0] + width, spot[1] + height))
        flat.xy += np.array(spot) + MARGIN - flat.xy.min(0)


def build_chart(base: BaseMesh, crop: Crop, template_mm: Float) -> Chart:
    """The whole chart for a (V, 3) template in mm with its origin between the eyes."""
    left = left_polygons(crop, template_mm)
    flats = [eye_disc(crop, 1, left[crop.part[left] == 1], EYE_RADIUS)]
    for island in cut(base, crop, template_mm):
        if island.name == "face":
            flats.append(flatten(crop, template_mm, island, None))
            continue
        flat = flatten(crop, template_mm, island, SMALL_PPM.get(island.name, 5.0))
        _upright(flat)
        flats.append(flat)
    place(flats)
    return mirror_chart(crop, flats, left)


def mirror_chart(crop: Crop, flats: list[Flat], left: Int) -> Chart:
    """Join the islands and add the other half: u <-> 1 - u."""
    polygon_uv = np.full((len(crop.polygons), 4), -1)
    xy, seam = [], []
    offset = 0
    for flat in flats:
        polygon_uv[flat.polygons] = np.where(flat.corners < 0, -1, flat.corners + offset)
        xy.append(flat.xy)
        seam.append(flat.on_midline)
        offset += len(flat.xy)
    points, on_seam = np.concatenate(xy), np.concatenate(seam)
    points[on_seam, 0] = 0.0
    partner = np.arange(len(points))
    partner[~on_seam] = len(points) + np.arange(int((~on_seam).sum()))
    uv = np.stack([0.5 + points[:, 0] / WIDTH, points[:, 1] / HEIGHT], 1)
    other = np.stack([0.5 - points[~on_seam, 0] / WIDTH, points[~on_seam, 1] / HEIGHT], 1)
    right_of = {tuple(sorted(p)): k for k, p in enumerate(crop.polygons.tolist())}
    for k in left:
        corners = crop.polygons[k]
        images = np.where(corners < 0, -1, crop.mirror[corners])
        target = right_of[tuple(sorted(images.tolist()))]
        lookup = {int(v): int(partner[u]) for v, u in zip(images, polygon_uv[k], strict=True) if v >= 0}
        polygon_uv[target] = [lookup[int(v)] if v >= 0 else -1 for v in crop.polygons[target]]
    return Chart(np.concatenate([uv, other]), polygon_uv)
