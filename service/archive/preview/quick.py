"""Quick pictures of a head and its parts, shaded at the vertices and without cast shadows."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from service.archive.surfaces import part_normals
from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, UInt8
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.normals import normalise
from service.geometry.raster import composite, fragments, interpolate, rasterise
from service.geometry.sampling import sample_chart
from service.head.model import HeadModel
from service.light.scene import Triple
from service.materials.material import ChartMap, OwnMap
from service.materials.of_head import material_of
from service.materials.part import MeshPart

CLAY = (0.50, 0.47, 0.44)
"""Linear albedo of the untextured skin."""
_PART_CLAY = {
    "eye": (0.72, 0.72, 0.72),
    "teeth": (0.68, 0.66, 0.60),
    "tongue": (0.42, 0.28, 0.26),
    "lashes": (0.26, 0.24, 0.22),
}

_NOWHERE = (0.0, 0.0, 0.0)
"""Unit vector where there is no direction: it receives no light."""

_WRAP = 0.25
"""Cosine by which light wraps around the terminator, which is soft under a large lamp."""
_GLOSS, _SHARPNESS = 0.05, 24
"""Strength and Blinn-Phong exponent of the highlight."""

_DARKEST = 0.82
"""Factor on coded colours of a texture at grazing angles; 1 where it faces the camera."""


@dataclass(frozen=True)
class Lamps:
    """Large distant lamps.

    Attributes:
        lamps: of each, the direction to it in camera axes (x right, y down, z away) and its linear RGB; the first one
            is the key light, which has a highlight.
        ambient: linear RGB from all directions.
    """

    lamps: tuple[tuple[Triple, Triple], ...]
    ambient: Triple

    def on(self, in_camera: AnyFloat, normals: AnyFloat, sheets: Bool) -> tuple[Float32, Float32]:
        """(V, 3) linear radiance of a white diffuse surface, and (V, 1) of the highlight.

        Args:
            in_camera: (V, 3) vertices, camera axes.
            normals: (V, 3) unit, camera axes.
            sheets: (V, 1) vertices of double-sided parts, which are shaded on both sides.
        """
        view = normalise(-in_camera, _NOWHERE)
        # Only double-sided parts show back faces. Elsewhere normals that face away lie at the silhouette; turned, they
        # would flash.
        facing = np.where(sheets & ((normals * view).sum(1, keepdims=True) < 0), -normals, normals)
        light = np.tile(np.array(self.ambient), (len(facing), 1))
        towards = normalise(np.array([direction for direction, _ in self.lamps]), _NOWHERE)
        for direction, (_, colour) in zip(towards, self.lamps, strict=True):
            light += np.clip((facing @ direction + _WRAP) / (1 + _WRAP), 0, 1)[:, None] ** 1.5 * np.array(colour)
        half = normalise(towards[0] + view, _NOWHERE)
        gloss = _GLOSS * np.clip((facing * half).sum(1, keepdims=True), 0, 1) ** _SHARPNESS
        return light.astype(np.float32), gloss.astype(np.float32)


STUDIO = Lamps(
    (
        ((-0.55, -0.60, -0.58), (0.86, 0.84, 0.80)),
        ((0.80, -0.15, -0.58), (0.16, 0.18, 0.22)),
        ((0.30, -0.45, 0.84), (0.30, 0.32, 0.36)),
    ),
    (0.15, 0.15, 0.17),
)
"""Key, fill and rim."""


def side_lamp(azimuth_deg: float) -> Lamps:
    """A strong lamp above eye level, ``azimuth_deg`` from the camera (> 0: at the image's right), and a dim sky."""
    angle = np.radians(azimuth_deg)
    key = (0.9 * float(np.sin(angle)), -0.45, -0.9 * float(np.cos(angle)))
    return Lamps(((key, (1.5, 1.46, 1.4)), ((0.0, -1.0, 0.3), (0.25, 0.27, 0.31))), (0.12, 0.125, 0.14))


def baked(in_camera: AnyFloat, normals: AnyFloat) -> Float32:
    """(V, 1) factor on the coded colours of a texture with baked-in light; arguments as :meth:`Lamps.on`."""
    cosine = (normals * normalise(-in_camera, _NOWHERE)).sum(1, keepdims=True)
    return np.asarray(_DARKEST + (1 - _DARKEST) * np.abs(cosine), np.float32)


def clay_colours(head: HeadModel) -> Float32:
    """(V, 3) linear albedo of each vertex by its part."""
    colours = np.tile(np.array(CLAY, np.float32), (len(head.mean), 1))
    for index, name in enumerate(head.part_names):
        colours[head.triangles[head.triangle_part == index]] = _PART_CLAY.get(material_of(name).name, CLAY)
    return colours


def sheets_of(head: HeadModel) -> Bool:
    """(V, 1) True for vertices of double-sided parts."""
    sheets = np.zeros((len(head.mean), 1), bool)
    sheets[head.triangles[double_sided(head)]] = True
    return sheets


def double_sided(head: HeadModel) -> Bool:
    """(T,) True for triangles of double-sided parts."""
    return np.array([material_of(name).double_sided for name in head.part_names])[head.triangle_part]


EDGE = 0.15
"""Width of the ramp of alpha around the cutoff of a masked part: a hard step would flicker at the size of previews."""


@dataclass(frozen=True)
class Shown:
    """What is drawn of the parts.

    Attributes:
        parts: those drawn.
        texture: (h, w, 3) uint8 sRGB on the chart, for parts that are coloured by it.
        lamps: light; None for colours in the photo's light, which are hardly shaded.
        light: (3,) factors on linear colours of the parts' own textures, from albedo to the photo's light.
        neutral: whether they are drawn without expression.
    """

    parts: Sequence[MeshPart]
    texture: UInt8
    lamps: Lamps | None
    light: Float32
    neutral: bool = False

    def vertices(self, part: MeshPart) -> Float32:
        """(N, 3) metres."""
        return part.neutral if self.neutral else part.vertices


def over_head(picture: Float32, nearest: Float32, shown: Shown, camera: Camera) -> Float32:
    """(h, w, 4) float32 premultiplied sRGB and coverage, with the parts drawn over the head.

    Args:
        picture: (h, w, 4) of the head alone.
        nearest: (h, w) metres, its depth; inf beside it.
        shown: the parts and their light.
        camera: of the picture's size, or a fraction of it.
    """
    height, width = nearest.shape
    scale = (width / camera.width, height / camera.height)
    pixels, depths, colours, alphas = [], [], [], []
    for part in shown.parts:
        if part.material.opacity <= 0:
            continue
        vertices = shown.vertices(part)
        triangles = part_triangles(part.polygons)
        places = part_triangles(part.polygons_uv, part.polygons)
        in_camera = camera.to_camera(vertices)
        flat = camera.project(vertices) * scale
        if not part.material.double_sided:
            front = _facing(flat, triangles)
            triangles, places = triangles[front], places[front]
        found = fragments(flat, in_camera[:, 2], triangles, width, height, nearer=nearest)
        if not len(found.pixel):
            continue
        corners = triangles[found.triangle]
        uv = interpolate(part.uv, places[found.triangle], found.barycentric)
        colour, alpha = painted(part, uv, shown.texture)
        normals = part_normals(part, vertices, triangles)
        turned = normals @ camera.rotation.T
        shade = _shaded(part, in_camera, turned, shown.lamps)
        light = interpolate(shade, corners, found.barycentric)
        pixels.append(found.pixel)
        depths.append(found.depth)
        colours.append(_lit(colour, light, shown))
        alphas.append(alpha)
    if not pixels:
        return picture
    pixel, depth, alpha = np.concatenate(pixels), np.concatenate(depths), np.concatenate(alphas)
    order = np.lexsort((depth, pixel))
    over = composite(pixel[order], np.concatenate(colours)[order], alpha[order], height * width)
    layer = over.reshape(height, width, 4)
    return np.asarray(layer + picture * (1 - layer[..., 3:]), np.float32)


def part_triangles(polygons: np.ndarray, like: np.ndarray | None = None) -> np.ndarray:
    """(T, 3) of (F, 4) polygons, in their order; ``like`` says which are triangles."""
    quads = (polygons if like is None else like)[:, 3] >= 0
    both = np.stack([polygons[:, [0, 1, 2]], polygons[:, [0, 2, 3]]], 1)
    keep = np.stack([np.ones_like(quads), quads], 1)
    return np.ascontiguousarray(both[keep])


def _facing(flat: Float64, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    return np.asarray((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]) < 0)


def painted(part: MeshPart, uv: Float32, chart_texture: UInt8) -> tuple[Float32, Float32]:
    """(N, 3) sRGB albedo in [0, 1] and (N,) alpha of a part at places (N, 2) of its texture, or of the chart's."""
    material, picture = part.material, part.material.colour_map
    alpha = np.full(len(uv), material.opacity, np.float32)
    colour = np.broadcast_to(linear_to_srgb(np.array(material.colour, np.float32)), (len(uv), 3))
    if isinstance(picture, ChartMap):
        return sample_chart(chart_texture, uv) / np.float32(255), alpha
    if isinstance(picture, OwnMap):
        values = sample_chart(picture.pixels, uv) / np.float32(255)
        colour = values[:, :3] if values.shape[1] >= 3 else np.repeat(values[:, :1], 3, 1)
        if picture.has_alpha and material.alpha != "opaque":
            alpha = alpha * values[:, 3]
    if material.alpha == "mask":
        alpha = np.clip((alpha - material.cutoff) / np.float32(EDGE) + np.float32(0.5), 0, 1)
    return np.asarray(colour, np.float32), np.asarray(alpha, np.float32)


def _shaded(part: MeshPart, in_camera: AnyFloat, normals: AnyFloat, lamps: Lamps | None) -> Float32:
    if lamps is None:
        return baked(in_camera, normals)
    sheets = np.full((len(normals), 1), part.material.double_sided)
    return np.concatenate(lamps.on(in_camera, normals, sheets), 1)


def _lit(colour: Float32, light: Float32, shown: Shown) -> Float32:
    """(N, 3) sRGB of albedo, sRGB, in the picture's light."""
    linear = srgb_to_linear(colour)
    if shown.lamps is not None:
        return linear_to_srgb(np.clip(linear * light[:, :3] + light[:, 3:], 0, 1))
    return np.asarray(linear_to_srgb(np.clip(linear * shown.light, 0, 1)) * light, np.float32)


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
