"""Triangles as pixels: the nearest by OpenCV's z-buffer, or all of them, and how much of each is seen through others.

For all of them every triangle is divided into pixel rows and every row into one span of pixel centres, so that only
covered pixels are visited. Two triangles that share an edge compute its crossing with a row from the same two points in
the same order, hence to the same bits, and spans are half open: no pixel between neighbours is missed or drawn twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, AnyInt, Bool, Float32, Float64, Int32, Int64
from service.geometry.camera import NEAREST_M

FARTHEST_PX = 1e7
"""Distance from the picture's origin up to which corners are drawn: OpenCV computes in single precision."""
CHUNK = 1 << 20
"""Rows or pixels processed at once; bounds the memory to some tens of megabytes."""


@dataclass(frozen=True)
class Raster:
    """Visible triangle of each pixel.

    Attributes:
        triangle: (H, W) int32 index of the nearest triangle, -1 where there is none.
        barycentric: (H, W, 3) float32 weights of the triangle's corners, in [0, 1], sum 1; 0 where there is none.
        depth: (H, W) float32 in the unit of the input, inf where there is none.
    """

    triangle: Int32
    barycentric: Float32
    depth: Float32

    @property
    def mask(self) -> Bool:
        """(H, W) bool, True where a triangle covers the pixel centre."""
        return self.triangle >= 0


@dataclass(frozen=True)
class Nearest:
    """Which triangle is nearest at each pixel centre; weights and depth are computed where they are asked for.

    Attributes:
        owner: (H, W) int32 position among ``kept``, -1 where there is none.
        away: (H, W) float32 depth over that of the nearest corner, with ``perspective``; more than any where none is.
        kept: (K,) int64 indices of the triangles that are drawn.
    """

    owner: Int32
    away: Float32
    kept: Int64
    _corners: Float64
    _planes: _Planes
    _perspective: bool

    def at(self, places: Int64) -> tuple[Int64, Float32, Float32]:
        """(N,) triangle, (N, 3) barycentric weights and (N,) depth at flat places (N,) where there is a triangle."""
        own, (row, column) = self.owner.ravel()[places].astype(np.int64), np.divmod(places, self.owner.shape[1])
        inside = _barycentric(self._planes, own, column + 0.5, row + 0.5, self._perspective)
        far = (inside * self._corners[own]).sum(1)
        return self.kept[own], inside.astype(np.float32), far.astype(np.float32)

    def depth_at(self, places: Int64, x: Float64, y: Float64) -> Float32:
        """(N,) depth of the triangles at flat places (N,) where their planes pass points (N,) beside them, within that
        of their corners.
        """
        return _depth(self._planes, self.owner.ravel()[places].astype(np.int64), x, y, self._perspective)


def nearest(
    points_2d: AnyFloat,
    depth: AnyFloat,
    triangles: AnyInt,
    width: int,
    height: int,
    *,
    cull: bool = False,
    perspective: bool = False,
) -> Nearest:
    """Nearest triangle at every pixel centre.

    Of two triangles at the same float32 depth the one with the lower index wins. A pixel centre that lies exactly on an
    edge belongs to the triangle on its right or, for a level edge, below (top-left rule). Triangles without area, with
    a corner that is not finite or farther than ``FARTHEST_PX``, wholly outside the image or, with ``perspective``, with
    a corner nearer than ``NEAREST_M`` are left out.

    Args:
        points_2d: (V, 2) pixels, x right, y down, centre of the top left pixel at (0.5, 0.5).
        depth: (V,) smaller is nearer; metres along the optical axis when ``perspective``.
        triangles: (T, 3) vertex indices.
        width: columns of the result.
        height: rows of the result.
        cull: leave out triangles that run clockwise as seen in the image (backs of outward faces).
        perspective: interpolate as for points projected by division by ``depth``; otherwise linearly in the image.
    """
    points = np.asarray(points_2d, np.float64)
    z = np.asarray(depth, np.float64)
    faces = np.asarray(triangles, np.int64).reshape(-1, 3)
    keep = _usable(points, z, faces, cull, perspective)
    keep = keep[_touches(points, faces[keep], width, height)]
    keep = keep[(np.abs(points[faces[keep]]) < FARTHEST_PX).all((1, 2))]
    corners = z[faces[keep]]
    planes = _Planes.through(points[faces[keep]], 1.0 / corners if perspective else corners)
    return Nearest(*_drawn(planes, width, height, perspective), keep, corners, planes, perspective)


def rasterise(
    points_2d: AnyFloat,
    depth: AnyFloat,
    triangles: AnyInt,
    width: int,
    height: int,
    *,
    cull: bool = False,
    perspective: bool = False,
) -> Raster:
    """Nearest triangle, barycentric coordinates and depth at every pixel centre; arguments as of :func:`nearest`."""
    found = nearest(points_2d, depth, triangles, width, height, cull=cull, perspective=perspective)
    hit = np.flatnonzero(found.owner.ravel() >= 0)
    triangle = np.full(width * height, -1, np.int32)
    far = np.full(width * height, np.inf, np.float32)
    weights = np.zeros((width * height, 3), np.float32)
    triangle[hit], weights[hit], far[hit] = found.at(hit)
    return Raster(triangle.reshape(height, width), weights.reshape(height, width, 3), far.reshape(height, width))


def _drawn(planes: _Planes, width: int, height: int, perspective: bool) -> tuple[Int32, Float32]:
    """(height, width) which triangle is nearest, -1 where there is none, by OpenCV's z-buffer, and that buffer.

    It draws in single precision what a camera with half an image's height to one of depth sees. The reciprocal of
    depth is linear in the image: that of ``planes``, or where they are linear themselves one that falls with them.
    """
    import cv2

    owner = np.full((height, width, 3), -1, np.float32)
    if not len(planes.corners):
        return owner[..., 0].astype(np.int32), np.ones((height, width), np.float32)
    value = planes.value
    if not perspective:
        value = 2 - (value - value.min()) / max(float(np.ptp(value)), np.finfo(np.float64).tiny)
    away = value.max() / value.ravel()
    flat = (planes.corners.reshape(-1, 2) * (1, -1) + (-width / 2, height / 2)) * (2 / height)
    vertices = np.column_stack([flat * away[:, None], -away]).astype(np.float32)
    corners = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    names = np.repeat(np.arange(len(corners), dtype=np.float32), 9).reshape(-1, 3)
    near, far = 0.99, float(away.max()) * 1.01
    settings = cv2.TriangleRasterizeSettings()
    settings.setShadingType(cv2.RASTERIZE_SHADING_FLAT)
    settings.setCullingMode(cv2.RASTERIZE_CULLING_NONE)
    depth = np.full((height, width), far, np.float32)
    cv2.triangleRasterize(vertices, corners, names, owner, depth, np.eye(4), np.pi / 2, near, far, settings)
    return owner[..., 0].astype(np.int32), depth


@dataclass(frozen=True)
class Fragments:
    """Every pixel centre that every triangle covers, by triangles in their order.

    Attributes:
        pixel: (N,) int64 flat index, row by row.
        triangle: (N,) int64 its triangle.
        barycentric: (N, 3) float32 weights of the triangle's corners, in [0, 1], sum 1.
        depth: (N,) float32 in the unit of the input.
    """

    pixel: Int64
    triangle: Int64
    barycentric: Float32
    depth: Float32


def fragments(
    points_2d: AnyFloat, depth: AnyFloat, triangles: AnyInt, width: int, height: int, *, nearer: Float32 | None = None
) -> Fragments:
    """All surfaces behind each pixel, for what is partly transparent; both sides of triangles are drawn.

    Points, perspective, edges and what is left out are as in :func:`rasterise`; with ``nearer`` (height, width) only
    fragments nearer than this are returned.
    """
    points, z = np.asarray(points_2d, np.float64), np.asarray(depth, np.float64)
    faces = np.asarray(triangles, np.int64).reshape(-1, 3)
    keep = _usable(points, z, faces, cull=False, perspective=True)
    keep = keep[_touches(points, faces[keep], width, height)]
    planes = _Planes.through(points[faces[keep]], 1.0 / z[faces[keep]])
    none = np.zeros(0, np.int64)
    found = [(none, none, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))]
    limit = None if nearer is None else np.asarray(nearer, np.float32).ravel()
    for rows in _spans(planes.corners, width, height):
        span, step = _expand(rows.stop - rows.start)
        pixel, far = _at(rows, planes, span, step, width, True)
        if limit is not None:
            shown = np.flatnonzero(far < limit[pixel])
            span, step, pixel, far = span[shown], step[shown], pixel[shown], far[shown]
        t, x, y = rows.triangle[span], (rows.start[span] + step).astype(np.float64), rows.y[span].astype(np.float64)
        found.append((pixel, keep[t], _barycentric(planes, t, x + 0.5, y + 0.5, True).astype(np.float32), far))
    pixels, owners, weights, depths = zip(*found, strict=True)
    return Fragments(*map(np.concatenate, (pixels, owners, weights, depths)))


def interpolate(values: AnyFloat, corners: AnyInt, weights: Float32) -> AnyFloat:
    """(N, C), of their type, of ``values`` (V, C) at barycentric or other ``weights`` (N, k) of vertices ``corners``
    (N, k).
    """
    from scipy.sparse import csr_array

    rows = np.arange(0, corners.size + 1, corners.shape[1])  # several times as fast as np.take, as a sparse matrix
    return np.asarray(csr_array((weights.ravel(), corners.ravel(), rows), (len(corners), len(values))) @ values)


def signed_area(points_2d: AnyFloat, triangles: AnyInt) -> Float64:
    """(T,) float64 twice the area in px^2, negative where the corners run counter-clockwise as seen (y is down)."""
    a, b, c = (np.asarray(points_2d, np.float64)[triangles[:, i]] for i in range(3))
    return np.asarray((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]))


def _usable(points: Float64, z: Float64, faces: Int64, cull: bool, perspective: bool) -> Int64:
    """Indices of the triangles that may be drawn."""
    finite = np.isfinite(points[:, 0]) & np.isfinite(points[:, 1]) & np.isfinite(z)
    if perspective:
        finite &= z >= NEAREST_M
    with np.errstate(invalid="ignore", over="ignore"):
        area = signed_area(points, faces)
    sound = finite[faces[:, 0]] & finite[faces[:, 1]] & finite[faces[:, 2]] & np.isfinite(area)
    return np.flatnonzero(sound & (area < 0 if cull else area != 0))


def _touches(points: Float64, faces: Int64, width: int, height: int) -> Bool:
    a, b, c = (points[faces[:, i]] for i in range(3))
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    across = (high[:, 0] > 0) & (low[:, 0] < width)
    return np.asarray(across & (high[:, 1] > 0) & (low[:, 1] < height))


@dataclass(frozen=True)
class _Planes:
    """Linear functions over triangles: corners (T, 3, 2), the interpolated value (T, 3) and gradients per pixel (T, 2).

    ``second`` and ``third`` are the gradients of the barycentric weights of corners 1 and 2, ``slope`` the value's.
    """

    corners: Float64
    value: Float64
    second: Float64
    third: Float64
    slope: Float64

    @classmethod
    def through(cls, corners: Float64, value: Float64) -> _Planes:
        d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = (d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1])[:, None]
        # The area of a sliver may be so small that its gradients overflow; it then counts as flat.
        with np.errstate(over="ignore", invalid="ignore"):
            second = np.stack([d2[:, 1], -d2[:, 0]], 1) / area
            third = np.stack([-d1[:, 1], d1[:, 0]], 1) / area
            slope = second * (value[:, 1] - value[:, 0])[:, None] + third * (value[:, 2] - value[:, 0])[:, None]
            total = second + third + slope
            sound = np.isfinite(total[:, :1] + total[:, 1:])
        return cls(corners, value, *(np.where(sound, g, 0.0) for g in (second, third, slope)))


@dataclass(frozen=True)
class _Rows:
    """One entry per triangle and pixel row: triangle, row, first and one past the last column."""

    triangle: Int64
    y: Int64
    start: Int64
    stop: Int64


def _spans(corners: Float64, width: int, height: int) -> Iterator[_Rows]:
    """All spans, in parts of at most about ``CHUNK`` rows and ``CHUNK`` pixels."""
    order = np.argsort(corners[:, :, 1], 1, kind="stable")
    ordered = np.take_along_axis(corners, order[:, :, None], 1)
    top = _first_centre(ordered[:, 0, 1], 0, height)
    bottom = _first_centre(ordered[:, 2, 1], 0, height)
    for part in _pieces(bottom - top):
        rows = _cut(ordered[part], top[part], (bottom - top)[part], width)
        for piece in _pieces(rows.stop - rows.start):
            yield _Rows(rows.triangle[piece] + part.start, rows.y[piece], rows.start[piece], rows.stop[piece])


def _first_centre(edge: Float64, low: int, high: int) -> Int64:
    """First pixel whose centre is at or beyond ``edge``, within [low, high]."""
    return np.ceil(np.clip(edge - 0.5, low, high)).astype(np.int64)


def _pieces(counts: Int64) -> Iterator[slice]:
    """Consecutive slices of ``counts`` whose sums are at most ``CHUNK`` (or one entry, if that is larger)."""
    total = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        before = int(total[begin - 1]) if begin else 0
        end = max(int(np.searchsorted(total, before + CHUNK, "right")), begin + 1)
        yield slice(begin, end)
        begin = end


def _cut(ordered: Float64, top: Int64, count: Int64, width: int) -> _Rows:
    """Spans of triangles whose corners are ordered by y and that cover ``count`` rows from ``top``."""
    run = ordered[:, [2, 1, 2]] - ordered[:, [0, 0, 1]]  # edges 0-2, 0-1, 1-2
    with np.errstate(over="ignore"):
        slopes = np.divide(run[..., 0], run[..., 1], out=np.zeros(run.shape[:2]), where=run[..., 1] > 0)
    slopes[~np.isfinite(slopes)] = 0.0  # so nearly level that no row but the corner's own can cross it
    triangle, step = _expand(count)
    y = top[triangle] + step
    centre = (y + 0.5).astype(np.float64)
    upper = centre < ordered[:, 1, 1][triangle]
    short_edge = np.where(upper, triangle, triangle + len(ordered))
    x_long = _crossing(ordered[:, 0], slopes[:, 0], triangle, centre)
    x_short = _crossing(ordered[:, :2].swapaxes(0, 1).reshape(-1, 2), slopes[:, 1:].T.ravel(), short_edge, centre)
    start = _first_centre(np.minimum(x_long, x_short), 0, width)
    stop = _first_centre(np.maximum(x_long, x_short), 0, width)
    filled = stop > start
    return _Rows(triangle[filled], y[filled], start[filled], stop[filled])


def _crossing(origin: Float64, slope: Float64, edge: Int64, y: Float64) -> Float64:
    """X of the edges at height y."""
    return np.asarray(origin[:, 0][edge] + (y - origin[:, 1][edge]) * slope[edge])


def _expand(counts: Int64) -> tuple[Int64, Int64]:
    """For counts (n0, n1, ...): index of the owner and position within it, both of length sum(counts)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]


def _at(rows: _Rows, planes: _Planes, span: Int64, step: Int64, width: int, perspective: bool) -> tuple[Int64, Float32]:
    """(N,) flat index of each pixel of the spans, and (N,) its depth."""
    corner, slope, value, t = planes.corners[:, 0], planes.slope, planes.value, rows.triangle
    at_start = value[:, 0][t] + slope[:, 0][t] * (rows.start + 0.5 - corner[:, 0][t])
    at_start += slope[:, 1][t] * (rows.y + 0.5 - corner[:, 1][t])
    interpolated = at_start[span] + slope[:, 0][t][span] * step
    return (rows.y * width + rows.start)[span] + step, _within(planes, t[span], interpolated, perspective)


def _depth(planes: _Planes, t: Int64, x: Float64, y: Float64, perspective: bool) -> Float32:
    """(N,) depth of triangles (N,) at points (N,)."""
    corner, slope = planes.corners[:, 0], planes.slope
    value = planes.value[:, 0][t] + slope[:, 0][t] * (x - corner[:, 0][t]) + slope[:, 1][t] * (y - corner[:, 1][t])
    return _within(planes, t, value, perspective)


def _within(planes: _Planes, t: Int64, value: Float64, perspective: bool) -> Float32:
    """(N,) depth of values (N,) on triangles (N,)."""
    # Slivers have huge gradients: a pixel never leaves the range of its corners.
    low = np.minimum(np.minimum(planes.value[:, 0], planes.value[:, 1]), planes.value[:, 2])
    high = np.maximum(np.maximum(planes.value[:, 0], planes.value[:, 1]), planes.value[:, 2])
    inside = np.clip(value, low[t], high[t])
    return np.asarray(1.0 / inside if perspective else inside, np.float32)


def _barycentric(planes: _Planes, t: Int64, x: Float64, y: Float64, perspective: bool) -> Float64:
    """(N, 3) weights of the corners of triangles ``t`` at (x, y), corrected for perspective if the value is 1/depth."""
    dx, dy = x - planes.corners[:, 0, 0][t], y - planes.corners[:, 0, 1][t]
    # Rounding can put a centre that lies on an edge just outside.
    second = np.clip(planes.second[:, 0][t] * dx + planes.second[:, 1][t] * dy, 0.0, 1.0)
    third = np.clip(planes.third[:, 0][t] * dx + planes.third[:, 1][t] * dy, 0.0, 1.0 - second)
    weights = np.stack([1.0 - second - third, second, third], 1)
    if perspective:
        weights *= planes.value[t]
        weights /= (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]
    return np.asarray(weights)


def transmittances(pixel: Int64, alpha: AnyFloat) -> Float32:
    """(N,) float32 share of light that reaches each fragment, of opacity (N,) in [0, 1], through those before it.

    Pixels (N,) are ascending, and fragments of one pixel go from near to far.
    """
    # Products over runs of equal pixels are differences of running sums of logarithms; opacity 1 would be infinite.
    through = np.log(np.maximum(1.0 - np.asarray(alpha, np.float64), 1e-9))
    before = np.concatenate([[0.0], np.cumsum(through)])[:-1]
    return np.asarray(np.exp(before - before[run_starts(pixel)]), np.float32)


def run_starts(values: Int64) -> Int64:
    """(N,) where the run of equal values (N,) begins in which each lies."""
    begins = np.diff(values, prepend=values[:1] - 1) != 0
    return np.maximum.accumulate(np.where(begins, np.arange(len(values)), 0))
