"""The UV chart as an image: the surface point of each texel, and tangent frames and derivatives on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, Int64, UInt8
from service.geometry.mesh import cross, normalise, summed, vertex_normals
from service.geometry.raster import interpolate, rasterise, signed_area
from service.head.model import HeadModel

Scalar = TypeVar("Scalar", bound=np.generic)

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

NO_PART = 255
"""Part id of texels outside all islands."""


@dataclass(frozen=True)
class TangentFrame:
    """Right-handed unit axes at each texel, each (H, W, 3) float32 in head space: u to the right, v up, normal out."""

    tangent: Float32
    bitangent: Float32
    normal: Float32


@dataclass(frozen=True, eq=False)
class Chart:
    """The chart of a head rasterised once; serves every head of the same topology.

    Texel (row r, column c) has its centre at u = (c + 0.5) / width, v = 1 - (r + 0.5) / height.

    Attributes:
        head: the model (only its topology and chart are used).
        width, height: size of the whole chart in texels.
        triangle: (H, W) int32 triangle of each texel, -1 outside the islands.
        barycentric: (H, W, 3) float32 weights of its corners.
        part: (H, W) uint8 index into ``head.part_names``, ``NO_PART`` outside.
        texels: (N,) int64 flat indices of the texels inside.
    """

    head: HeadModel
    width: int
    height: int
    triangle: Int32
    barycentric: Float32
    part: UInt8
    texels: Int64

    @classmethod
    def build(cls, head: HeadModel, width: int, height: int) -> Chart:
        """Rasterise the chart."""
        points = chart_points(head, width, height)
        raster = rasterise(points, np.zeros(len(points)), head.triangle_uv, width, height)
        part = np.full(raster.triangle.shape, NO_PART, np.uint8)
        part[raster.mask] = head.triangle_part[raster.triangle[raster.mask]]
        texels = np.flatnonzero(raster.mask)
        return cls(head, width, height, raster.triangle, raster.barycentric, part, texels)

    @property
    def mask(self) -> Bool:
        """(H, W) bool, True inside the islands."""
        return self.triangle >= 0

    @cached_property
    def corners(self) -> Int32:
        """(N, 3) int32 vertices of the triangle that each inner texel shows."""
        return self.head.triangles[self.triangle.ravel()[self.texels]]

    @cached_property
    def weights(self) -> Float32:
        """(N, 3) float32 barycentric weights of ``corners``."""
        return self.barycentric.reshape(-1, 3)[self.texels]

    @cached_property
    def inner_part(self) -> UInt8:
        """(N,) uint8 part of each inner texel."""
        return self.part.ravel()[self.texels]

    @cached_property
    def _chart_corners(self) -> Int32:
        return self.head.triangle_uv[self.triangle.ravel()[self.texels]]

    @cached_property
    def _nearest(self) -> Int64:
        return nearest_inside(self.mask)

    def interpolate(self, values: AnyFloat) -> Float32:
        """(H, W, C) float32 of per-vertex values (V, C) or (V,); 0 outside the islands."""
        return self.spread(self.inside(values))

    def inside(self, values: AnyFloat, *, on_chart: bool = False) -> Float32:
        """(N, C) float32 at the inner ``texels`` of values per vertex (V, C) or (V,).

        With ``on_chart`` the values belong to chart vertices (U, C), which may differ across a cut.
        """
        v = np.asarray(values, np.float32)
        v = v[:, None] if v.ndim == 1 else v
        return interpolate(v, self._chart_corners if on_chart else self.corners, self.weights)

    def spread(self, values: AnyFloat, outside: tuple[float, ...] | float = 0.0) -> Float32:
        """(H, W, C) float32 image of values (N, C) at the inner ``texels``; ``outside`` elsewhere."""
        count = values.shape[1]
        result = np.full((self.triangle.size, count), outside, np.float32)
        texel = f"V{4 * count}"  # moved as one thing: half the time of so many numbers
        result.view(texel)[self.texels] = np.ascontiguousarray(values, np.float32).view(texel)
        return result.reshape(*self.triangle.shape, -1)

    def gather(self, per_triangle: AnyFloat) -> Float32:
        """(H, W, ...) float32 of values per triangle (T, ...); 0 outside the islands."""
        values = np.asarray(per_triangle, np.float32)
        flat = np.take(values.reshape(len(values), -1), self.triangle.ravel()[self.texels], axis=0)
        return self.spread(flat).reshape(*self.triangle.shape, *values.shape[1:])

    def normals(self, vertices: AnyFloat) -> Float32:
        """(H, W, 3) float32 unit normals in the frame of ``vertices`` (V, 3); (0, 0, 1) outside the islands."""
        return self.spread(unit_vectors(self.inside(vertex_normals(vertices, self.head.triangles)), _Z), _Z)

    def frame(self, vertices: AnyFloat, vertex_normal: AnyFloat | None = None) -> TangentFrame:
        """Tangent frame per texel: normal interpolated from the vertices (V, 3), tangent along +u made orthogonal to
        it.

        A tangent-space normal (x, y, z) means x * tangent + y * bitangent + z * normal: +Y up as in OpenGL and glTF.
        Where the direction of +u is degenerate the tangent is arbitrary; outside the islands the axes are x, y, z.
        ``vertex_normal`` (V, 3) unit takes the place of the vertices' own.
        """
        n = vertex_normals(vertices, self.head.triangles) if vertex_normal is None else vertex_normal
        normal = unit_vectors(self.inside(n), _Z)
        along = self.inside(tangents(self.head, vertices), on_chart=True)
        along -= normal * dot(along, normal)
        degenerate = dot(along, along)[:, 0] < 1e-12
        if degenerate.any():
            along[degenerate] = any_orthogonal(normal[degenerate])
        tangent = unit_vectors(along, _X)
        bitangent = cross(normal, tangent)
        return TangentFrame(self.spread(tangent, _X), self.spread(bitangent, _Y), self.spread(normal, _Z))

    def metric(self, vertices: AnyFloat) -> Float32:
        """(H, W, 3) float32 first fundamental form E, F, G in mm^2 per texel^2 of ``vertices`` in metres; 0 outside.

        E = |X_u|^2, F = X_u . X_v, G = |X_v|^2; X_u, X_v are the change of position per texel to the right and up.
        """
        du, dv = _derivatives(self.head, vertices)
        du, dv = du * (1000.0 / self.width), dv * (1000.0 / self.height)
        pairs = ((du, du), (du, dv), (dv, dv))
        return self.gather(np.stack([np.einsum("ti,ti->t", a, b) for a, b in pairs], 1))

    def fill_outside(self, image: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
        """Copy of (H, W) or (H, W, C) in which every texel outside the islands has the value of the nearest inside."""
        flat = np.take(image.reshape(self.triangle.size, -1), self._nearest.ravel(), axis=0)
        return flat.reshape(image.shape)


def chart_points(head: HeadModel, width: int, height: int) -> Float64:
    """(U, 2) float64 positions of the chart vertices in texels, x right, y down, texel centres at +0.5."""
    return head.uv.astype(np.float64) * [width, -height] + [0.0, height]


def mirrored_map(image: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """The same map with left and right of the head swapped (u <-> 1 - u); valid because charts are mirror-symmetric."""
    return np.flip(image, 1)


def nearest_inside(mask: Bool) -> Int64:
    """(H, W) int64 flat index of the nearest True texel of ``mask``; each texel's own index where there is none."""
    import cv2

    index = np.arange(mask.size).reshape(mask.shape)
    if mask.all() or not mask.any():
        return index
    outside = (~mask).astype(np.uint8)
    label = np.asarray(cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1])
    source = np.zeros(int(label.max()) + 1, np.int64)
    source[label[mask]] = index[mask]
    return np.asarray(source[label])


def dot(a: Float32, b: Float32) -> Float32:
    """(N, 1) float32 dot products of (N, 3)."""
    return np.asarray(a[:, :1] * b[:, :1] + a[:, 1:2] * b[:, 1:2] + a[:, 2:] * b[:, 2:])


def unit_vectors(vectors: Float32, fallback: tuple[float, float, float] = _Z) -> Float32:
    """Unit vectors (N, 3) float32 of averaged unit vectors; ``fallback`` where the length is below 1e-6."""
    length = np.sqrt(dot(vectors, vectors))[:, 0]
    sound = length > 1e-6
    length[~sound] = 1
    # Column by column: a third of the time of rows of three.
    result = np.stack([vectors[:, k] / length for k in range(3)], 1)
    result[~sound] = fallback
    return np.asarray(result)


def any_orthogonal(normal: Float32) -> Float32:
    """(N, 3) vectors of length at least 0.5 orthogonal to unit normals."""
    axis = np.where(np.abs(normal[:, :1]) < 0.7, np.asarray(_X, np.float32), np.asarray(_Y, np.float32))
    return np.asarray(axis - normal * dot(axis, normal))


def tangents(head: HeadModel, vertices: AnyFloat) -> Float64:
    """(U, 3) float64 unit direction of +u at each chart vertex, area-weighted mean of its triangles; 0 where none."""
    du, _ = _derivatives(head, vertices)
    weighted = du * np.abs(signed_area(head.uv, head.triangle_uv))[:, None]
    total = summed(head.triangle_uv.ravel(), np.repeat(weighted, 3, 0), len(head.uv))
    return normalise(total, (0.0, 0.0, 0.0))


def _derivatives(head: HeadModel, vertices: AnyFloat) -> tuple[Float64, Float64]:
    """(T, 3) change of position per unit of u and of v, constant on a triangle; 0 where the chart has no area."""
    return solve_affine(head.uv[head.triangle_uv].astype(np.float64), np.asarray(vertices, np.float64)[head.triangles])


def solve_affine(source: AnyFloat, target: AnyFloat) -> tuple[Float64, Float64]:
    """Derivatives of the affine maps that take source triangles (T, 3, 2) to target triangles (T, 3, C).

    Two (T, C) float64: d target / d source x and d target / d source y; 0 where the source has no area.
    """
    s, t = np.asarray(source, np.float64), np.asarray(target, np.float64)
    s1, s2 = s[:, 1] - s[:, 0], s[:, 2] - s[:, 0]
    t1, t2 = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    area = s1[:, 0] * s2[:, 1] - s1[:, 1] * s2[:, 0]
    sound = np.abs(area) > 1e-18
    inverse = np.where(sound, 1.0 / np.where(sound, area, 1.0), 0.0)[:, None]
    return (t1 * s2[:, 1:] - t2 * s1[:, 1:]) * inverse, (t2 * s1[:, :1] - t1 * s2[:, :1]) * inverse


_SHIFT = 4
"""Fractional bits of OpenCV's fixed-point coordinates."""


@lru_cache(maxsize=1)
def islands(head: HeadModel, size: tuple[int, int]) -> UInt8:
    """(H, W) uint8 part of each texel of a map (width, height), ``NO_PART`` outside all islands; of the last size kept.

    A texel that an outline crosses is inside.
    """
    import cv2

    points = np.rint((chart_points(head, *size) - 0.5) * 2**_SHIFT).astype(np.int32)
    result = np.full(size[::-1], NO_PART, np.uint8)
    for index in range(len(head.part_names)):
        chosen = head.triangle_uv[head.triangle_part == index]
        for triangle in points[chosen]:
            cv2.fillConvexPoly(result, triangle, index, cv2.LINE_8, _SHIFT)
    result.flags.writeable = False
    return result
