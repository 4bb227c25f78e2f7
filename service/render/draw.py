"""What a camera sees of a head and of the parts beside it: points of both, and their light made pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, Int64, UInt8
from service.colour import srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.raster import fragments, interpolate, nearest, run_starts, signed_area, transmittances
from service.geometry.sampling import sample_chart
from service.materials.material import ChartMap, OwnMap
from service.materials.part import MeshPart
from service.render.drawn import DrawnHead, DrawnPart, bent, painted
from service.render.fibres import widened

HIDDEN = 1e-3
"""Share of a fragment's light that reaches the camera below which it is not lit."""
LAYER = 1000
"""Triangles of a part that are drawn at once, from near to far, of those that no solid card of earlier layers hides."""
REACH = 16
"""Samples to each side of a triangle's middle between which all is looked at that may hide it."""
SOLID = 0.95
"""Opacity from which on a card counts as solid."""
FAINT = 0.05
"""Share of a sample below which a ribbon's width counts as none."""
STEEP = 4.0
"""Difference of depth within a sample, over the sample's side, from which on the sample counts as an edge."""


@dataclass
class SeenPart:
    """Fragments of a part, F of them, hidden ones too.

    Attributes:
        drawn: the part.
        corners: (F, 3) its vertices around each fragment, with barycentric ``weights`` (F, 3).
        pixel: (F,) flat position among the picture's samples.
        colour: (F, 3) linear albedo, and their opacity ``alpha`` (F,).
        radiance: (F, 3) linear; black until somebody lights the part.
        normals: (F, 3) unit, by the part's own normal map; None where it has none.
        uv: (F, 2) places on its texture.
    """

    drawn: DrawnPart
    corners: Int32
    weights: Float32
    uv: Float32
    pixel: Int64
    colour: Float32
    alpha: Float32
    radiance: Float32
    normals: Float32 | None = None

    @property
    def part(self) -> MeshPart:
        """What is seen."""
        return self.drawn.part

    @cached_property
    def along(self) -> Float32 | None:
        """(F, 3) unit, the strands of hair from root to tip; None of all else."""
        return self.drawn.strands(self.corners, self.weights, self.uv)

    def openness(self) -> Float32:
        """(F, 1) share in [0, 1] of the sky that reaches it by its cavity map; 1 of what has none."""
        cavity = self.part.material.cavity_map
        if not isinstance(cavity, OwnMap):
            return np.ones((len(self.uv), 1), np.float32)
        return sample_chart(cavity.pixels, self.uv) / np.float32(255)

    def between(self, values: Float32) -> Float32:
        """(F, C) of values (V, C) at the part's vertices."""
        return interpolate(values, self.corners, self.weights)


@dataclass(frozen=True)
class SeenHead:
    """The points that a picture shows, N of them on the head.

    Attributes:
        model: what is seen.
        camera: of the picture.
        shape: rows and columns of samples, several per pixel.
        index: (N,) flat position among them.
        corners: (N, 3) vertices around each point, and its barycentric ``weights`` (N, 3).
        uv: (N, 2) on the chart.
        position_m: (N, 3) head space.
        alpha: (N,) opacity in [0, 1]: 1, or where the point stands for a piece of a sample at an edge the piece's share
            of what nearer pieces leave.
        parts: all else.
        order: of the head's points and the fragments of all parts, by sample and there from near to far.
    """

    model: DrawnHead
    camera: Camera
    shape: tuple[int, int]
    index: Int64
    corners: Int32
    weights: Float32
    uv: Float32
    position_m: Float32
    alpha: Float32
    parts: tuple[SeenPart, ...]
    order: Int64

    def read(self, image: Float32) -> Float32:
        """(N, C) of a chart image (H, W, C) or (H, W), bilinear, borders repeated."""
        return sample_chart(image, self.uv)

    def recoloured(self, chart: Float32) -> Float32:
        """(N, 3) of another chart image (H, W, 3), which parts that have their colours on the chart take too."""
        for one in self.parts:
            if isinstance(one.part.material.colour_map, ChartMap):
                one.colour = sample_chart(chart, one.uv)
        return self.read(chart)

    def between(self, values: Float32) -> Float32:
        """(N, C) of values (V, C) at the head's vertices."""
        return interpolate(values, self.corners, self.weights)

    @cached_property
    def _reached(self) -> Float32:
        """Share in [0, 1] of the head's points and all fragments that others leave open, in ``order``."""
        alpha = np.concatenate([self.alpha, *(one.alpha for one in self.parts)])
        return transmittances(self._pixel, alpha[self.order])

    @cached_property
    def _pixel(self) -> Int64:
        return np.concatenate([self.index, *(one.pixel for one in self.parts)])[self.order]

    def reached(self) -> list[Float32]:
        """(F,) share in [0, 1] of each part's fragments that others leave open."""
        share = np.zeros(len(self.order), np.float32)
        share[self.order] = self._reached
        return np.split(share, np.cumsum([len(self.index), *(len(one.alpha) for one in self.parts)]))[1:-1]

    @cached_property
    def _mixing(self) -> Any:
        """Sparse matrix from the head's points and all fragments to samples."""
        from scipy.sparse import csr_array

        alpha = np.concatenate([self.alpha, *(one.alpha for one in self.parts)])[self.order]
        count = self.shape[0] * self.shape[1]
        starts = np.concatenate([[0], np.cumsum(np.bincount(self._pixel, minlength=count))])
        return csr_array((self._reached * alpha, self.order, starts), (count, len(alpha)))

    def resolved(self, radiance: Float32) -> tuple[Float32, Float32]:
        """(h, w, 3) linear radiance (of the head's points: (N, 3)) times coverage, and (h, w) coverage, means over each
        pixel.
        """
        import cv2

        colours = np.concatenate([radiance, *(one.radiance for one in self.parts)]).astype(np.float32, copy=False)
        picture = self._mixing @ np.concatenate([colours, np.ones((len(colours), 1), np.float32)], 1)
        size = (self.camera.width, self.camera.height)
        whole = np.minimum(picture, np.array([np.inf, np.inf, np.inf, 1], np.float32)).reshape(*self.shape, 4)
        small = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
        return small[..., :3], small[..., 3]


Projected = Callable[[AnyFloat], tuple[Float64, Float64]]
"""From points (V, 3), metres, to places (V, 2) in samples and depth (V,)."""


def see(model: DrawnHead, camera: Camera, samples: float, chart: Float32 | None = None, *, pieces: int = 1) -> SeenHead:
    """Rasterise a head and the parts beside it, with so many samples per pixel and axis, at least 1.

    Samples at edges of what is opaque are divided into ``pieces`` per axis, an odd number; hair is as smooth as the
    means of its texture. ``chart`` (h, w, 3) are linear colours, for parts that have theirs on the chart.
    """
    width, height = round(camera.width * samples), round(camera.height * samples)

    def projected(points: AnyFloat) -> tuple[Float64, Float64]:
        flat = camera.project(points) * (width / camera.width, height / camera.height)
        return flat, camera.to_camera(points)[:, 2]

    solid = [one for one in model.parts if one.part.material.alpha == "opaque"]
    own = (model.vertices, model.head.triangles, False)
    meshes = [own, *((one.part.vertices, one.triangles, one.part.material.double_sided) for one in solid)]
    points, farthest = _opaque(meshes, projected, (height, width), pieces, STEEP / camera.focal_px / samples)
    found = points[0]
    corners = model.head.triangles[found.triangle]
    uv = interpolate(model.head.uv, model.head.triangle_uv[found.triangle], found.weights)
    position = interpolate(np.asarray(model.vertices, np.float32), corners, found.weights)
    parts, keys = [], [found.key]
    for drawn, one in zip(solid, points[1:], strict=True):
        if len(one.pixel):
            place = interpolate(drawn.part.uv, drawn.places[one.triangle], one.weights)
            colour = painted(drawn.part, place, chart)
            turned = bent(drawn, one.triangle, one.weights, place)
            around, dark = drawn.triangles[one.triangle], np.zeros_like(colour)
            parts.append(SeenPart(drawn, around, one.weights, place, one.pixel, colour, one.alpha, dark, turned))
            keys.append(one.key)
    others = [one for one in model.parts if one.part.material.alpha != "opaque"]
    for drawn in sorted(others, key=lambda one: one.part.material.alpha != "mask"):  # what hides the others first
        found_in = _sheer(drawn, projected, farthest, chart)
        if found_in is not None:
            parts.append(found_in[0])
            keys.append(found_in[1])
    order = np.argsort(np.concatenate(keys), kind="stable")
    return SeenHead(
        model, camera, (height, width), found.pixel, corners, found.weights, uv, position, found.alpha, tuple(parts),
        order,
    )  # fmt: skip


@dataclass(frozen=True)
class _Points:
    """Points of one opaque mesh, N of them: triangle (N,), weights (N, 3), sample (N,), opacity (N,), key (N,)."""

    triangle: Int64
    weights: Float32
    pixel: Int64
    alpha: Float32
    key: Int64


def _keys(pixel: Int64, depth: Float32) -> Int64:
    """(N,) in the order of samples and there from near to far: depths are positive, so their bits are in order."""
    return (pixel << 32) | depth.view(np.int32)


def _opaque(
    meshes: Sequence[tuple[AnyFloat, Int32, bool]], projected: Projected, shape: tuple[int, int], pieces: int,
    steep: float,
) -> tuple[list[_Points], Float32]:  # fmt: skip
    """The nearest points of meshes (vertices, triangles, whether both sides are drawn), and (h, w) the depth up to
    which others may be seen.

    A sample at an edge has several points. ``steep`` is the difference of depth, over depth, that makes an edge.
    """
    import cv2

    starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in meshes)])
    flat, depth = projected(np.concatenate([vertices for vertices, _, _ in meshes]))
    moved = [triangles + np.int32(start) for (_, triangles, _), start in zip(meshes, starts, strict=False)]
    front = [
        np.flatnonzero(double | (signed_area(flat, faces) < 0))
        for (_, _, double), faces in zip(meshes, moved, strict=True)
    ]
    faces = np.concatenate([one[some] for one, some in zip(moved, front, strict=True)])
    names = np.repeat(np.arange(len(meshes)), [len(some) for some in front])
    height, width = shape
    seen = nearest(flat * pieces, depth, faces, width * pieces, height * pieces, perspective=True)
    mesh = np.append(names[seen.kept], len(meshes)).astype(np.uint8)[seen.owner]

    def spread(image: UInt8 | Float32) -> list[Any]:
        square, middles = np.ones((pieces, pieces), np.uint8), slice(pieces // 2, None, pieces)
        return [np.asarray(way(image, square)[middles, middles]).ravel() for way in (cv2.erode, cv2.dilate)]

    (first, last), (near, far) = spread(mesh), spread(seen.away)
    edge = (first != last) | (far - near > np.float32(steep) * near)
    plain, broken = np.flatnonzero(~edge & (first < len(meshes))), np.flatnonzero(edge)
    wide = width * pieces
    steps = (np.arange(pieces)[:, None] * wide + np.arange(pieces)).ravel()
    base = np.arange(height)[:, None] * (pieces * wide) + np.arange(width) * pieces
    place = np.concatenate([base.ravel()[plain] + steps[len(steps) // 2], (base.ravel()[broken, None] + steps).ravel()])
    pixel = np.concatenate([plain, np.repeat(broken, len(steps))])
    share = np.where(np.arange(len(pixel)) < len(plain), 1.0, 1.0 / len(steps))
    name = mesh.ravel()[place]
    chosen = np.argsort(name, kind="stable")[: int((name < len(meshes)).sum())]
    place, pixel, share, name = place[chosen], pixel[chosen], share[chosen], name[chosen]
    triangle, weights, depth_there = seen.at(place)
    if len(broken):
        # All else is seen at the middle of its sample, where a steep surface is nearer or farther than at its pieces.
        row, column = np.divmod(pixel, width)
        depth_there = seen.depth_at(place, (column + 0.5) * pieces, (row + 0.5) * pieces)
    key = _keys(pixel, depth_there)
    covered = np.bincount(pixel, share, height * width).astype(np.float64)
    cracked = _cracked(covered.reshape(shape))[pixel]
    share[cracked] /= covered[pixel[cracked]]
    farthest = np.zeros(height * width, np.float32)
    np.maximum.at(farthest, pixel, depth_there)
    farthest[np.bincount(pixel, share, height * width) < 1 - 1e-6] = np.inf
    alpha, pieced = np.ones(len(pixel), np.float32), np.flatnonzero(share < 1)
    alpha[pieced] = _opacity(pixel[pieced], share[pieced], np.argsort(key[pieced], kind="stable"))
    own = np.concatenate(front)[triangle]
    ends = np.cumsum(np.bincount(name, minlength=len(meshes)))
    rows = [slice(end - count, end) for end, count in zip(ends, np.bincount(name, minlength=len(meshes)), strict=True)]
    points = [_Points(own[some], weights[some], pixel[some], alpha[some], key[some]) for some in rows]
    return points, farthest.reshape(shape)


def _cracked(covered: AnyFloat) -> Bool:
    """(h * w,) whether a sample is covered in part between two that are covered: two meshes meet there, no background
    shows.
    """
    import cv2

    full = (covered > 1 - 1e-6).astype(np.uint8)
    ends = np.array([[1, 0, 1]], np.uint8)
    beside, above = (
        cv2.erode(full, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(0.0,)) for kernel in (ends, ends.T)
    )
    return np.asarray((full == 0) & ((beside > 0) | (above > 0))).ravel()


def _opacity(pixel: Int64, share: Float64, order: Int64) -> Float32:
    """(N,) opacity of pieces of samples, with which they get their ``share`` (N,) one behind the other.

    ``order`` (N,) is by sample and there from near to far.
    """
    total = np.cumsum(share[order])
    before = total - share[order]
    before -= before[run_starts(pixel[order])]
    alpha = np.zeros(len(pixel), np.float32)
    alpha[order] = np.minimum(share[order] / np.maximum(1 - before, 1e-9), 1)
    return alpha


def _sheer(
    drawn: DrawnPart, projected: Projected, farthest: Float32, chart: Float32 | None
) -> tuple[SeenPart, Int64] | None:
    """Fragments of a part that is not opaque, and their keys, if it has any; where it is solid, ``farthest`` (h, w)
    becomes nearer.
    """
    import cv2

    height, width = farthest.shape
    flat, depth = projected(drawn.part.vertices)
    kept = drawn.part.material.double_sided | (signed_area(flat, drawn.triangles) < 0)
    flat, triangles, was, share = widened(flat, drawn.triangles)
    depth = depth[was]
    front = np.flatnonzero(kept & (share > FAINT))
    if drawn.fibres is not None:
        level = drawn.fibres.levels(flat, triangles, drawn.corners_uv)
    front = front[np.argsort(sum(depth[corner] for corner in drawn.triangles[front].T), kind="stable")]
    corners = flat[triangles[front].T]  # (3, T, 2)
    low, high = corners.min(0), corners.max(0)
    column, row = np.clip(np.nan_to_num(0.5 * (low + high)), 0, (width - 1, height - 1)).astype(np.int64).T
    middle, near = row * width + column, depth[triangles[front].T].min(0)
    near[(high - low).max(1) > 2 * (REACH - 1)] = 0  # not all that may hide them is looked at
    left, made = np.arange(len(front)), []
    while len(left):
        around = np.asarray(cv2.dilate(farthest, np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8))).ravel()
        left = left[near[left] <= around[middle[left]]]
        some, left = front[left[:LAYER]], left[LAYER:]
        found = fragments(flat, depth, triangles[some], width, height, nearer=farthest)
        if not len(found.pixel):
            continue
        shown = some[found.triangle]
        place = interpolate(drawn.part.uv, drawn.places[shown], found.barycentric)
        texel = None if drawn.fibres is None else drawn.fibres.read(place, level[shown])
        alpha = share[shown] * (drawn.opacity(place) if texel is None else texel[:, 3])
        pixel, inside, far = found.pixel, found.barycentric, found.depth
        if drawn.part.material.alpha == "mask":
            solid = alpha >= SOLID
            alpha[solid] = 1
            np.minimum.at(farthest.ravel(), pixel[solid], far[solid])
        rest = np.flatnonzero((alpha > 0) & (far <= farthest.ravel()[pixel]))
        if not len(rest):
            continue
        colour = painted(drawn.part, place[rest], chart) if texel is None else srgb_to_linear(texel[rest, :3])
        made.append((*(one[rest] for one in (shown, inside, place, pixel, alpha, far)), colour))
    if not made:
        return None
    shown, inside, place, pixel, alpha, far, colour = map(np.concatenate, zip(*made, strict=True))
    turned, around, dark = bent(drawn, shown, inside, place), drawn.triangles[shown], np.zeros_like(colour)
    return SeenPart(drawn, around, inside, place, pixel, colour, alpha, dark, turned), _keys(pixel, far)
