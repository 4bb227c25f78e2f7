"""Unwrap the photo onto the chart: the colour of each texel, and a weight that says how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Bool, Float32, Float64, Int64
from service.colour import bytes_to_linear, linear_to_srgb
from service.face.fit.result import Fit
from service.geometry.camera import NEAREST_M, Camera
from service.geometry.chart import Chart, chart_points, dot, solve_affine, unit_vectors
from service.geometry.normals import vertex_normals
from service.geometry.raster import rasterise
from service.geometry.sampling import Pyramid, sample_area
from service.photo.photo import Photo

BUFFER_SIDE = 512
"""Longer side of the head in the z-buffer, in cells of about 0.6 mm, whatever the photo's resolution."""

BIAS_M = 0.0015
"""Depth bias: a texel at most this far behind the z-buffer counts as visible; slant adds to it."""

STEP_M = 0.006
"""Difference in depth between neighbouring cells of the z-buffer that makes an occlusion edge."""

OUTLINE_MARGIN_M = (0.003, 0.010)
"""Distance from the head's outline: the weight is 0 up to the first, and not reduced from the second on.

The fitted outline is off by a millimetre or two, and hair, collar or wall on a cheek is worse than an inpainted cheek.
"""

INNER_MARGIN_M = (0.0005, 0.003)
"""The same from occlusion edges within the head (nose before cheek, lip before teeth): less, as both sides are skin."""

GRAZING = (0.12, 0.35)
"""Cosine of the viewing angle below which the weight is 0, and from which on it is the cosine's square."""


@dataclass(frozen=True)
class Unwrapped:
    """What the photo shows of each inner texel of the chart, in the order of ``chart.texels``.

    Attributes:
        colour: (N, 3) float32 sRGB in [0, 1]; 0 where ``weight`` is 0.
        weight: (N,) float32 in [0, 1]: squared cosine of the viewing angle, less near outlines and occlusion edges.
        visible: (N,) bool: in the photo, facing the camera and not occluded by the head.
        normal: (N, 3) float32 unit normals in head space.
        position: (N, 3) float32 metres, head space.
    """

    colour: Float32
    weight: Float32
    visible: Bool
    normal: Float32
    position: Float32


def unwrap(photo: Photo, fit: Fit, chart: Chart) -> Unwrapped:
    """Project every texel into the photo, test it against the z-buffer of the whole head and read its colour."""
    camera, head = fit.camera, chart.head
    both = chart.inside(np.c_[fit.vertices, vertex_normals(fit.vertices, head.triangles)])
    position, normal = both[:, :3], unit_vectors(both[:, 3:])
    facing = dot(normal, unit_vectors(camera.centre.astype(np.float32) - position))[:, 0]
    front = np.flatnonzero(facing > 0)  # the back half needs no further look
    depth = camera.to_camera(position[front])[:, 2]
    pixel = camera.project(position[front])
    within = np.all((pixel > 0.5) & (pixel < np.array(photo.size) - 0.5), 1) & (depth > NEAREST_M)

    buffer = _Buffer.draw(camera, fit, chart)
    nearest, margin = buffer.look_up(pixel, depth, facing[front])
    visible = np.zeros(len(position), bool)
    visible[front] = within & nearest
    ramp = np.clip((facing[front] - GRAZING[0]) / (GRAZING[1] - GRAZING[0]), 0.0, 1.0)
    weight = np.zeros(len(position), np.float32)
    weight[front] = np.where(visible[front], ramp * facing[front] ** 2 * margin, 0.0)

    colour = np.zeros((len(position), 3), np.float32)
    shown = np.flatnonzero(weight[front] > 0)
    colour[front[shown]] = _read(photo, fit, chart, pixel[shown], front[shown])
    return Unwrapped(colour, weight, visible, normal, position)


def _read(photo: Photo, fit: Fit, chart: Chart, pixel: Float64, chosen: Int64) -> Float32:
    """Colours (n, 3) sRGB at photo pixels (n, 2), averaged in linear light over each texel's area in the photo."""
    if not len(chosen):
        return np.zeros((0, 3), np.float32)
    head = chart.head
    low = np.maximum(np.floor(pixel.min(0)).astype(int) - 8, 0)
    high = np.ceil(pixel.max(0)).astype(int) + 8
    crop = bytes_to_linear(photo.pixels[low[1] : high[1], low[0] : high[0]])
    texel = chart_points(head, chart.width, chart.height)[head.triangle_uv]
    du, dv = solve_affine(texel, fit.camera.project(fit.vertices)[head.triangles])
    jacobian = np.stack([du, dv], -1)[chart.triangle.ravel()[chart.texels[chosen]]]
    return linear_to_srgb(sample_area(Pyramid.build(crop), pixel - low, jacobian))


@dataclass(frozen=True)
class _Buffer:
    """Z-buffer of the head within the bounding box of its projection.

    Attributes:
        origin: (2,) photo pixels of the buffer's corner.
        scale: cells per photo pixel.
        metres: size of a cell at a depth of one metre.
        depth: (h, w) float32 metres, inf where there is no head.
        margin: (h, w) float32 in [0, 1], 0 at outlines and occlusion edges, 1 far from them.
    """

    origin: Float64
    scale: float
    metres: float
    depth: Float32
    margin: Float32

    @classmethod
    def draw(cls, camera: Camera, fit: Fit, chart: Chart) -> _Buffer:
        """Rasterise the fitted head; empty where it lies behind the camera."""
        points = camera.project(fit.vertices)
        z = camera.to_camera(fit.vertices)[:, 2]
        before = z >= NEAREST_M
        if not before.any():
            return cls(np.zeros(2), 1.0, 1.0, np.full((1, 1), np.inf, np.float32), np.zeros((1, 1), np.float32))
        # Vertices close to the camera plane project arbitrarily far out: draw only what may fall into the photo.
        size = np.array([camera.width, camera.height], float)
        low = np.maximum(points[before].min(0), -size) - 2
        high = np.minimum(points[before].max(0), 2 * size) + 2
        extent = np.maximum(high - low, 1.0)
        scale = BUFFER_SIDE / float(extent.max())
        width, height = (int(n) for n in np.ceil(extent * scale))
        raster = rasterise((points - low) * scale, z, chart.head.triangles, width, height, perspective=True)
        metres = 1.0 / (camera.focal_px * scale)
        cell = metres * float(np.median(z[before]))
        return cls(low, scale, metres, raster.depth, _margins(raster.depth, cell))

    def look_up(self, pixel: Float64, depth: Float64, facing: Float32) -> tuple[Bool, Float64]:
        """(N,) bool, whether points are not occluded, and (N,) their margin.

        Args:
            pixel: (N, 2) photo pixels.
            depth: (N,) metres.
            facing: (N,) cosine of the viewing angle.
        """
        cell = np.clip((pixel - self.origin) * self.scale, 0, [self.depth.shape[1] - 1, self.depth.shape[0] - 1])
        column, row = cell.astype(int).T
        cosine = np.clip(facing, 0.15, 1.0)
        slant = np.sqrt(1 - cosine**2) / cosine
        bias = BIAS_M + self.metres * depth * slant
        return depth <= self.depth[row, column] + bias, self.margin[row, column].astype(np.float64)


def _margins(depth: Float32, cell: float) -> Float32:
    """(h, w) in [0, 1], how far each cell is from outlines and inner edges; ``cell`` is its side in metres."""
    far = np.where(np.isfinite(depth), depth, np.float32(1e3))
    square = np.ones((3, 3), np.uint8)
    background = np.asarray(cv2.dilate((~np.isfinite(depth)).astype(np.uint8), square)) > 0
    drop = np.asarray(cv2.dilate(far, square)) - np.asarray(cv2.erode(far, square))
    inner = (drop > STEP_M) & ~background
    margin = np.ones(depth.shape, np.float32)
    for edge, (none, full) in ((background, OUTLINE_MARGIN_M), (inner, INNER_MARGIN_M)):
        if edge.any():
            distance = np.asarray(cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 3)) * cell
            margin = np.minimum(margin, np.clip((distance - none) / (full - none), 0.0, 1.0).astype(np.float32))
    return margin
