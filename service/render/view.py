"""Where the camera of a picture stands, and what of the head each of its samples sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.archive.materials import material_of
from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int64
from service.errors import UsageError
from service.geometry.camera import NEAREST_M, Camera
from service.geometry.normals import normalise
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.light.scene import DEFAULT_VIEW, Triple

VIEWS = {"front": 0.0, "three-quarter": 35.0, "left": 90.0, "right": -90.0, "back": 180.0}
"""Degrees about the vertical by which the camera goes around the head, towards the subject's left."""

FILLED = 0.92
"""Share of the picture's width or height that the head takes up."""

_NOT_LOOKING = 1e-6


def viewpoint_of(view: str | None, viewpoints: tuple[Triple, ...]) -> Triple:
    """Where the camera stands: a named view or an angle at the default distance, else the scene's first viewpoint.

    Raises:
        UsageError: the view is neither a name nor a number of degrees.
    """
    if view is None:
        return viewpoints[0]
    degrees = VIEWS.get(view)
    if degrees is None:
        try:
            degrees = float(view)
        except ValueError:
            degrees = float("nan")
        if not -360.0 <= degrees <= 360.0:
            names = ", ".join(VIEWS)
            raise UsageError(f"view is {view!r}; it has to be {names}, or degrees from -360 to 360", field="view")
    distance, angle = DEFAULT_VIEW[2], np.radians(degrees)
    return float(distance * np.sin(angle)), 0.0, float(distance * np.cos(angle))


def camera_at(viewpoint: Triple, vertices: AnyFloat, width: int, height: int) -> Camera:
    """Camera at a point in head space that looks at the middle of the head, upright, the head filling the picture.

    Args:
        viewpoint: metres.
        vertices: (V, 3) of what is drawn.
        width: of the picture in pixels.
        height: of the picture in pixels.

    Raises:
        UsageError: the point lies in the head or nearly so.
    """
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    offset = (low + high) / 2 - np.asarray(viewpoint, np.float64)
    forward = normalise(offset, (0.0, 0.0, -1.0))
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.999 else np.array([0.0, 0.0, np.sign(forward[1])])
    right = normalise(np.cross(forward, up))
    rotation = np.stack([right, np.cross(forward, right), forward])
    camera = Camera(width, height, 1.0, np.zeros(2), rotation, -rotation @ np.asarray(viewpoint, np.float64))
    nearest = float(camera.to_camera(vertices)[:, 2].min())
    if not nearest >= NEAREST_M:
        where = ", ".join(f"{value:g}" for value in viewpoint)
        raise UsageError(
            f"the viewpoint ({where}) is {nearest:.3f} m before the head; at least {NEAREST_M} m are needed",
            field="viewpoints",
        )
    flat = camera.project(vertices)
    start, stop = flat.min(0), flat.max(0)
    focal = FILLED * float(np.min(np.array([width, height]) / np.maximum(stop - start, _NOT_LOOKING)))
    principal = np.array([width, height]) / 2 - focal * (start + stop) / 2
    return Camera(width, height, focal, principal, camera.rotation, camera.translation)


@dataclass(frozen=True)
class Samples:
    """The samples of a picture that see the head, N of them.

    Attributes:
        shape: rows and columns of samples; ``finer`` of them a pixel and axis.
        index: (N,) flat position among them.
        uv: (N, 2) on the chart.
        position_m: (N, 3) head space.
    """

    shape: tuple[int, int]
    index: Int64
    uv: Float32
    position_m: Float32

    @classmethod
    def of(cls, head: HeadModel, vertices: AnyFloat, camera: Camera, finer: int) -> Samples:
        """What each sample sees; parts that are not drawn (opacity 0) are looked through."""
        width, height = camera.width * finer, camera.height * finer
        drawn = np.array([material_of(name).opacity > 0 for name in head.part_names])[head.triangle_part]
        triangles, chart = head.triangles[drawn], head.triangle_uv[drawn]
        depth = camera.to_camera(vertices)[:, 2]
        raster = rasterise(
            camera.project(vertices) * finer, depth, triangles, width, height, cull=True, perspective=True
        )
        index = np.flatnonzero(raster.triangle >= 0)
        triangle, weights = raster.triangle.ravel()[index], raster.barycentric.reshape(-1, 3)[index]
        uv, position = (
            _mixed(weights, source, corners[triangle])
            for source, corners in ((head.uv, chart), (np.asarray(vertices), triangles))
        )
        return cls((height, width), index, uv, position)

    def read(self, image: Float32) -> Float32:
        """(N, C) of a chart image (H, W, C) or (H, W), bilinear, borders repeated."""
        import cv2

        height, width = image.shape[:2]
        rows = max(-(-len(self.uv) // 1024), 1)
        places = np.zeros((rows * 1024, 2), np.float32)
        places[: len(self.uv), 0] = self.uv[:, 0] * width - 0.5
        places[: len(self.uv), 1] = (1 - self.uv[:, 1]) * height - 0.5
        at = places.reshape(rows, 1024, 2)
        pieces = [
            cv2.remap(image, at[first : first + 16384], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
            for first in range(0, rows, 16384)
        ]
        values = np.concatenate([np.asarray(piece).reshape(-1, *image.shape[2:]) for piece in pieces])
        return np.asarray(values[: len(self.uv)].reshape(len(self.uv), -1), np.float32)


def texels_a_pixel(head: HeadModel, vertices: AnyFloat, camera: Camera) -> float:
    """Side of a pixel on the chart as a share of its width, median over the skin that the camera sees; 0 for none."""
    points = camera.project(vertices)
    seen, chart = (
        _areas(points[head.triangles]),
        _areas(head.uv[head.triangle_uv].astype(np.float64) * [1.0, 2.0 / 3.0]),
    )
    usable = (seen < -1e-3) & (np.abs(chart) > 0) & (head.triangle_part == 0)
    if not usable.any():
        return 0.0
    ratio, size = np.abs(chart[usable]) / -seen[usable], -seen[usable]
    order = np.argsort(ratio, kind="stable")
    until = size[order].cumsum()
    return float(np.sqrt(ratio[order][int(np.searchsorted(until, until[-1] / 2))]))


def _areas(corners: Float64) -> Float64:
    """(T,) signed areas of (T, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _mixed(weights: Float32, values: AnyFloat, corners: AnyInt) -> Float32:
    source = np.asarray(values, np.float32)
    mixed: Float32 = weights[:, :1] * source[corners[:, 0]]
    for i in (1, 2):
        mixed += weights[:, i : i + 1] * source[corners[:, i]]
    return mixed
