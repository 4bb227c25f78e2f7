"""Parts beside the head's own in a picture: hair, lashes, brows and bust, every layer of their cards.

Their light is the environment's irradiance and that of the lamps on the body that the cards make up. They throw no
shadow, neither on each other nor on the head, and have no highlights of strands. What lies in the mouth has the light
that comes in between the lips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.anatomy.mouth.light import PARTS as IN_THE_MOUTH
from service.anatomy.mouth.light import light_inside, opening
from service.archive.preview.parts import painted, part_triangles
from service.archive.reading import StoredPart
from service.archive.surface import part_normals
from service.archive.unpack import unpack_texture
from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import srgb_to_linear
from service.errors import BadArchive, NumericFault
from service.geometry.camera import Camera
from service.geometry.layers import composite
from service.geometry.raster import fragments, interpolate, rasterise
from service.head.model import HeadModel
from service.light.environment import Illumination
from service.light.graphs import Graphs, lamp_numbers
from service.light.harmonics import irradiance, project
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart

NO_SHADOWS = "part-shadows-not-simulated"
"""Fallback: hair and other parts throw no shadows in the picture."""


def mesh_part(stored: StoredPart) -> MeshPart:
    """A part of an archive.

    Raises:
        BadArchive: its mesh, material or texture cannot be used.
    """
    given, mesh = stored.material, stored.mesh
    try:
        picture = None if stored.png is None else OwnMap("own", unpack_texture(stored.png, stored.name))
        red, green, blue = given.colour
        material = Material(
            "own", (red, green, blue), picture, opacity=given.opacity, alpha=given.alpha, cutoff=given.cutoff,
            double_sided=given.double_sided,
        )  # fmt: skip
        points = mesh.vertices.astype(np.float32)
        has_uv = (mesh.polygon_uv[:, 0] >= 0).all()
        uv, uv_faces = (mesh.uv, mesh.polygon_uv) if has_uv else (np.zeros((len(points), 2)), None)
        return MeshPart(
            stored.name, points, points, mesh.polygons, uv.astype(np.float32), material, uv_faces=uv_faces
        )
    except NumericFault as fault:
        raise BadArchive(f"the part {stored.name[:40]!r} of the archive cannot be used: {fault}") from fault


@dataclass(frozen=True)
class PartLight:
    """Light on parts, without shadows."""

    light: Illumination
    graphs: Graphs

    def on(self, points: Float32, normals: AnyFloat) -> Float32:
        """(N, 3) radiance of a white diffuse surface at points (N, 3) in metres with unit normals (N, 3)."""
        arriving = np.zeros((3, len(points)), np.float32)
        if not self.light.dark:
            arriving += irradiance(project(self.light.sky), normals).T.astype(np.float32)
        at = {
            "position": np.ascontiguousarray(points.T * np.float32(1000)),
            "normal": np.ascontiguousarray(np.asarray(normals, np.float32).T),
            "shade": np.ones(len(points), np.float32),
        }
        for lamp in self.light.lights:
            arriving += self.graphs.at_points("irradiance", at, **lamp_numbers(lamp))
        return np.asarray(arriving.T / np.float32(np.pi), np.float32)


def parts_layer(
    parts: Sequence[MeshPart], head: HeadModel, vertices: AnyFloat, camera: Camera, light: PartLight,
    chart_albedo: UInt8, supersampling: int = 1,
) -> Float32:  # fmt: skip
    """(H W, 4) float32 linear radiance premultiplied by coverage, and coverage, of the parts before the head.

    H W are the samples of the picture, row by row: where a part goes on from the head, as the bust does, a sample shows
    either, and no gap is left between two edges that are half covered.

    Args:
        parts: with textures of their own or on the chart.
        head: topology, without parts that others replace.
        vertices: (V, 3) metres.
        camera: of the picture.
        light: on the parts.
        chart_albedo: (h, w, 3) uint8 sRGB, for parts that are coloured by the chart.
        supersampling: samples per pixel and axis.
    """
    width, height = camera.width * supersampling, camera.height * supersampling

    def seen(points: AnyFloat) -> tuple[Float64, Float64]:
        return camera.project(points) * supersampling, camera.to_camera(points)[:, 2]

    nearest = rasterise(*seen(vertices), head.triangles, width, height, cull=True, perspective=True).depth
    lips = opening(head, vertices)
    pixels, depths, colours, alphas = [], [], [], []
    for part in parts:
        if part.material.opacity <= 0:
            continue
        triangles, places = part_triangles(part.polygons), part_triangles(part.polygons_uv, part.polygons)
        found = fragments(*seen(part.vertices), triangles, width, height, nearer=nearest)
        if not len(found.pixel):
            continue
        colour, alpha = painted(part, interpolate(part.uv, places[found.triangle], found.barycentric), chart_albedo)
        normals = part_normals(part, part.vertices, triangles)
        lit = light.on(part.vertices, normals)
        if part.name in IN_THE_MOUTH:
            lit = lit * light_inside(part.vertices, normals, lips)[:, None]
        shade = interpolate(lit, triangles[found.triangle], found.barycentric)
        pixels.append(found.pixel)
        depths.append(found.depth)
        colours.append(srgb_to_linear(colour) * shade)
        alphas.append(alpha)
    if not pixels:
        return np.zeros((height * width, 4), np.float32)
    pixel = np.concatenate(pixels)
    order = np.lexsort((np.concatenate(depths), pixel))
    return composite(pixel[order], np.concatenate(colours)[order], np.concatenate(alphas)[order], width * height)
