"""Parts beside the head's own in a preview: every fragment of hair, lashes and the like, blended from near to far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.archive.preview.shading import Lamps, baked
from service.archive.surface import part_normals
from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.layers import composite
from service.geometry.raster import fragments, interpolate
from service.geometry.sampling import sample_chart
from service.materials.material import ChartMap, OwnMap
from service.materials.part import MeshPart

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
