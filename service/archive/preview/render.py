"""Small renders of the head from any camera: untextured, with its texture, or with its albedo under lamps."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from service.archive.preview.parts import Shown, over_head
from service.archive.preview.shading import STUDIO, Lamps, baked, clay_colours, double_sided, sheets_of
from service.arrays import AnyFloat, Float32, Float64, Int32, UInt8
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.raster import interpolate, rasterise
from service.geometry.sampling import sample_chart
from service.head.model import HeadModel
from service.materials.of_head import material_of

Image = UInt8

DISTANCE_M = 1.2
"""From camera to head in all views but the photo's."""


@dataclass(frozen=True)
class Rendered:
    """A picture without background.

    Attributes:
        colour: (h, w, 3) float32 sRGB in [0, 1], premultiplied by coverage.
        coverage: (h, w, 1) float32 in [0, 1], share of the pixel that the head covers.
    """

    colour: Float32
    coverage: Float32

    def over(self, background: Float32) -> Float32:
        """(h, w, 3) sRGB float32 in [0, 1] over a background that broadcasts to this shape."""
        return np.asarray(self.colour + (1 - self.coverage) * background, np.float32)


def turned_camera(vertices: AnyFloat, yaw_deg: float, width: int, height: int) -> Camera:
    """Camera at ``DISTANCE_M`` that sees all of ``vertices`` (V, 3) turned by ``yaw_deg`` (> 0: to the image right).

    The scale depends on the head alone and not on the yaw, so that views side by side have the same one.
    """
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    angle = np.radians(yaw_deg)
    cosine, sine = np.cos(angle), np.sin(angle)
    about_y = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    rotation = np.diag([1.0, -1.0, -1.0]) @ about_y
    translation = np.array([0.0, 0.0, DISTANCE_M]) - rotation @ ((low + high) / 2)
    extent = max(float(high[1] - low[1]) / height, float(max(high[0] - low[0], high[2] - low[2])) / width, 1e-6)
    focal = 0.86 * DISTANCE_M / extent
    return Camera(width, height, focal, np.array([width / 2, height / 2]), rotation, translation)


def render(
    head: HeadModel,
    vertices: AnyFloat,
    normals: AnyFloat,
    camera: Camera,
    texture: Image | None = None,
    *,
    lamps: Lamps | None = None,
    supersampling: float = 1.5,
    parts: Shown | None = None,
) -> Rendered:
    """Render the head with shading at its vertices, which lie a few pixels apart.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres, head space.
        normals: (V, 3) unit.
        camera: its width and height are the size of the picture.
        texture: (h, w, 3) uint8 sRGB on the chart; None for a uniform colour per part.
        lamps: light for a texture that is albedo; None for a texture with baked-in light, which is hardly shaded.
            Without texture, None is ``STUDIO``.
        supersampling: samples per pixel and axis, >= 1; 1.5 antialiases at half the cost of 2.
        parts: meshes beside the head's own, drawn with it.
    """
    import cv2

    width, height = round(camera.width * supersampling), round(camera.height * supersampling)
    in_camera = camera.to_camera(vertices)
    points = camera.project(vertices) * (width / camera.width, height / camera.height)
    turned = np.asarray(normals) @ camera.rotation.T
    if texture is None:
        light, gloss = (lamps or STUDIO).on(in_camera, turned, sheets_of(head))
        shade = linear_to_srgb(clay_colours(head) * light + gloss)
    elif lamps is None:
        shade = baked(in_camera, turned)
    else:
        shade = np.concatenate(lamps.on(in_camera, turned, sheets_of(head)), 1)
    picture = np.zeros((height, width, 4), np.float32)
    nearest = np.full((height, width), np.inf, np.float32)
    replaced = {name for part in parts.parts for name in part.replaces} if parts else set()
    for layer in _layers(head, replaced):
        x, y = _window(points[np.unique(layer.triangles)], width, height)
        local = points - (x.start, y.start)
        raster = rasterise(
            local, in_camera[:, 2], layer.triangles, x.stop - x.start, y.stop - y.start, cull=True, perspective=True
        )
        here, depth = picture[y, x], nearest[y, x]
        shown = np.flatnonzero(raster.mask & (raster.depth <= depth))
        if not len(shown):
            continue
        triangle, weights = raster.triangle.ravel()[shown], raster.barycentric.reshape(-1, 3)[shown]
        colour = interpolate(shade, layer.triangles[triangle], weights)
        if texture is not None:
            painted = sample_chart(texture, interpolate(head.uv, layer.chart[triangle], weights)) / np.float32(255)
            colour = _in_light(painted, colour) if lamps is not None else painted * colour
        paint = np.zeros(here.shape, np.float32)
        flat = paint.reshape(-1, 4)
        flat[shown, :3] = colour * np.float32(layer.opacity)
        flat[shown, 3] = layer.opacity
        if layer.opacity < 1:
            paint += here * (1 - paint[..., 3:])
        picture[y, x] = paint
        nearest[y, x] = np.minimum(raster.depth, depth)
    if parts:
        picture = over_head(picture, nearest, parts, camera)
    if supersampling > 1:
        size = (camera.width, camera.height)
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)
    return Rendered(picture[..., :3], picture[..., 3:])


@dataclass(frozen=True)
class _Layer:
    """Triangles (T, 3) of one opacity and their chart vertices (T, 3)."""

    triangles: Int32
    chart: Int32
    opacity: float


def _layers(head: HeadModel, replaced: Collection[str]) -> list[_Layer]:
    """Layers by falling opacity, without parts of opacity 0 and those that others stand in for.

    Double-sided triangles come a second time with reversed winding, as back faces are culled.
    """
    materials = [material_of(name) for name in head.part_names]
    layers = []
    for opacity in sorted({material.opacity for material in materials} - {0.0}, reverse=True):
        own = [material.opacity == opacity and name not in replaced
               for name, material in zip(head.part_names, materials, strict=True)]  # fmt: skip
        chosen = np.array(own)[head.triangle_part]
        double = chosen & double_sided(head)
        triangles = np.concatenate([head.triangles[chosen], head.triangles[double][:, ::-1]])
        chart = np.concatenate([head.triangle_uv[chosen], head.triangle_uv[double][:, ::-1]])
        if len(triangles):
            layers.append(_Layer(triangles, chart, opacity))
    return layers


def _window(points: Float64, width: int, height: int) -> tuple[slice, slice]:
    """Columns and rows of the picture that points (N, 2) can touch; at least one pixel."""
    bounds = []
    for values, end in zip(np.nan_to_num(points).T, (width, height), strict=True):
        low = int(np.clip(np.floor(values.min()), 0, end - 1))
        bounds.append(slice(low, int(np.clip(np.ceil(values.max()), low + 1, end))))
    return bounds[0], bounds[1]


def _in_light(albedo: Float32, light: Float32) -> Float32:
    """(N, 3) sRGB of an albedo (N, 3), sRGB, in light (N, 4): linear RGB, and gloss on top of it."""
    return np.asarray(linear_to_srgb(np.clip(srgb_to_linear(albedo) * light[:, :3] + light[:, 3:], 0, 1)), np.float32)
