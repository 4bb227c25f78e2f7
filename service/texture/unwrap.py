"""From photo to chart: what colour each texel shows and how far that is to be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import bytes_to_linear, linear_to_srgb
from service.face.fit.result import Fit
from service.geometry.camera import NEAREST_M, Camera
from service.geometry.chart import Chart, chart_points, dot, solve_affine, unit
from service.geometry.normals import vertex_normals
from service.geometry.raster import rasterise
from service.geometry.sampling import Pyramid, sample_area
from service.photo.photo import Photo

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

BUFFER_SIDE = 512
"""Longer side of the head in the z-buffer, in cells (about 0.6 mm); does not depend on the photo's resolution."""

BIAS_M = 0.0015
"""A texel this far behind what the z-buffer saw still counts as seen; slant adds to it."""

STEP_M = 0.006
"""A jump in depth that makes an edge behind which the photo shows something else than the head's surface."""

OUTLINE_MARGIN_M = (0.003, 0.010)
"""Next to the background: worth nothing up to the first distance, everything from the second on.

The fitted outline is wrong by a millimetre or two, and hair, collar or wall on a cheek is worse than a cheek made up.
"""

INNER_MARGIN_M = (0.0005, 0.003)
"""The same behind and on edges within the head (nose before cheek, lip before teeth): skin beside skin hurts less."""

GRAZING = (0.12, 0.35)
"""Cosine of the viewing angle below which a texel is worthless, and from which on only its square counts."""


@dataclass(frozen=True)
class Unwrapped:
    """What the photo shows of each inner texel of the chart, in the order of ``chart.texels``.

    Attributes:
        colour: (N, 3) float32 sRGB in [0, 1]; 0 where ``weight`` is 0.
        weight: (N,) float32 in [0, 1]: squared cosine of the viewing angle, less near outlines and behind edges.
        visible: (N,) bool, in the photo, facing the camera, and nothing of the head before it.
        normal: (N, 3) float32 unit normals in head space.
        position: (N, 3) float32 metres, head space.
    """

    colour: Float
    weight: Float
    visible: npt.NDArray[np.bool_]
    normal: Float
    position: Float


def unwrap(photo: Photo, fit: Fit, chart: Chart) -> Unwrapped:
    """Project every texel into the photo, test it against the z-buffer of the whole head and read its colour."""
    camera, head = fit.camera, chart.head
    both = chart.inside(np.c_[fit.vertices, vertex_normals(fit.vertices, head.triangles)])
    position, normal = both[:, :3], unit(both[:, 3:])
    facing = dot(normal, unit(camera.centre.astype(np.float32) - position))[:, 0]
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


def _read(photo: Photo, fit: Fit, chart: Chart, pixel: Array, chosen: npt.NDArray[np.int64]) -> Float:
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
    """Z-buffer of the head around its own projection.

    Attributes:
        origin: (2,) photo pixels of the buffer's corner.
        scale: cells per photo pixel.
        metres: (per unit depth) size of a cell.
        depth: (h, w) float32 metres, inf where there is no head.
        margin: (h, w) float32 in [0, 1], 0 on edges, 1 far from them.
    """

    origin: Array
    scale: float
    metres: float
    depth: Float
    margin: Float

    @classmethod
    def draw(cls, camera: Camera, fit: Fit, chart: Chart) -> _Buffer:
        points = camera.project(fit.vertices)
        z = camera.to_camera(fit.vertices)[:, 2]
        before = z >= NEAREST_M
        if not before.any():
            return cls(np.zeros(2), 1.0, 1.0, np.full((1, 1), np.inf, np.float32), np.zeros((1, 1), np.float32))
        # A head that reaches past the camera projects to wild places: only what may fall into the photo is drawn.
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

    def look_up(self, pixel: Array, depth: Array, facing: Float) -> tuple[npt.NDArray[np.bool_], Array]:
        """Whether points are the nearest ones (N,), and their margin (N,)."""
        cell = np.clip((pixel - self.origin) * self.scale, 0, [self.depth.shape[1] - 1, self.depth.shape[0] - 1])
        column, row = cell.astype(int).T
        cosine = np.clip(facing, 0.15, 1.0)
        slant = np.sqrt(1 - cosine**2) / cosine
        bias = BIAS_M + self.metres * depth * slant
        return depth <= self.depth[row, column] + bias, self.margin[row, column].astype(np.float64)


def _margins(depth: Float, cell: float) -> Float:
    """How far (0 to 1) each cell is from outlines and from inner edges; ``cell`` is its side in metres."""
    import cv2

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
