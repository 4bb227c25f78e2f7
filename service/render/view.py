"""Placement of the camera."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat
from service.errors import UsageError
from service.geometry.camera import NEAREST_M, Camera
from service.geometry.mesh import normalise
from service.geometry.raster import signed_area
from service.head.model import HeadModel
from service.light.scene import DEFAULT_VIEW, Triple
from service.render.request import degrees_of

FILLED, TURNED_FILLED = 0.92, 0.86
"""Fraction of the picture's width or height that the head fills; for cameras at one scale that of its bounding box."""


def viewpoint_of(view: str | None, viewpoints: tuple[Triple, ...]) -> Triple:
    """Position of the camera, metres: a named view or angle at the default distance, else the scene's first viewpoint.

    UsageError: the view is neither a name nor a number of degrees.
    """
    if view is None:
        return viewpoints[0]
    distance, angle = DEFAULT_VIEW[2], np.radians(degrees_of(view))
    return float(distance * np.sin(angle)), 0.0, float(distance * np.cos(angle))


def camera_at(viewpoint: Triple, vertices: AnyFloat, width: int, height: int) -> Camera:
    """Upright camera at a point in head space that looks at the head's centre and fills the picture with the head.

    The viewpoint is in metres, ``vertices`` (V, 3) are what is drawn, width and height of the picture in pixels.
    UsageError: the point lies within ``NEAREST_M`` of the head, or in it.
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
            f"the viewpoint ({where}) is {nearest:.3f} m in front of the head; it has to be at least {NEAREST_M} m",
            field="viewpoints",
        )
    flat = camera.project(vertices)
    start, stop = flat.min(0), flat.max(0)
    focal = FILLED * float(np.min(np.array([width, height]) / np.maximum(stop - start, 1e-6)))
    principal = np.array([width, height]) / 2 - focal * (start + stop) / 2
    return Camera(width, height, focal, principal, camera.rotation, camera.translation)


def turned_camera(vertices: AnyFloat, yaw_deg: float, width: int, height: int) -> Camera:
    """Camera in front of a head that is turned by ``yaw_deg`` (> 0: to the image right) and all in the picture.

    The scale depends on the head alone and not on the yaw, so that views side by side have the same one.
    """
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    angle = np.radians(yaw_deg)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.diag([1.0, -1.0, -1.0]) @ np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    translation = np.array([0.0, 0.0, DEFAULT_VIEW[2]]) - rotation @ ((low + high) / 2)
    extent = max(float(high[1] - low[1]) / height, float(max(high[0] - low[0], high[2] - low[2])) / width, 1e-6)
    focal = TURNED_FILLED * DEFAULT_VIEW[2] / extent
    return Camera(width, height, focal, np.array([width / 2, height / 2]), rotation, translation)


def pixel_on_chart(head: HeadModel, vertices: AnyFloat, camera: Camera) -> float:
    """Side of a pixel on the chart, over the chart's width: median over the visible skin, 0 without skin."""
    points = camera.project(vertices)
    seen = 0.5 * signed_area(points, head.triangles)
    chart = 0.5 * signed_area(head.uv.astype(np.float64) * [1.0, 2.0 / 3.0], head.triangle_uv)
    usable = (seen < -1e-3) & (np.abs(chart) > 0) & (head.triangle_part == 0)
    if not usable.any():
        return 0.0
    ratio, size = np.abs(chart[usable]) / -seen[usable], -seen[usable]
    order = np.argsort(ratio, kind="stable")
    until = size[order].cumsum()
    return float(np.sqrt(ratio[order][int(np.searchsorted(until, until[-1] / 2))]))
