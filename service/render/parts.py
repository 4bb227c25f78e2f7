"""Parts beside the head's own in a picture: hair, lashes, brows and bust, every layer of their cards.

Their light is the environment's irradiance and that of the lamps on the body that the cards make up. They throw no
shadow, neither on each other nor on the head, and have no highlights of strands. Eyes and what lies in the mouth have
the light that reaches them there (``service.render.recess``), and mirror the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.archive.preview.quick import painted, part_triangles
from service.archive.reading import StoredPart, unpack_texture
from service.archive.surfaces import part_normals
from service.arrays import AnyFloat, AnyInt, Bool, Float32, Float64, UInt8
from service.colour import srgb_to_linear
from service.errors import BadArchive, NumericFault
from service.geometry.camera import Camera
from service.geometry.raster import Fragments, composite, fragments, interpolate, rasterise, transmittances
from service.head.model import HeadModel
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart
from service.render.recess import RECESSES, Nodes, PartLight, Recess, recess_of, skin_around

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
            double_sided=given.double_sided, roughness=given.roughness, ior=given.ior, specular=given.specular,
            transmission=given.transmission,
        )  # fmt: skip
        points = mesh.vertices.astype(np.float32)
        has_uv = (mesh.polygon_uv[:, 0] >= 0).all()
        uv, uv_faces = (mesh.uv, mesh.polygon_uv) if has_uv else (np.zeros((len(points), 2)), None)
        return MeshPart(stored.name, points, points, mesh.polygons, uv.astype(np.float32), material, uv_faces=uv_faces)
    except NumericFault as fault:
        raise BadArchive(f"the part {stored.name[:40]!r} of the archive cannot be used: {fault}") from fault


HIDDEN = 1e-3
"""Share of a fragment's light that reaches the camera below which it is not lit."""


@dataclass
class _Drawn:
    """Fragments of one part.

    Attributes:
        part: with triangles (T, 3).
        found: the fragments; colour (F, 3) sRGB and alpha (F,) of each.
        visible: (F,) whether it is not hidden by others.
        radiance: (F, 3) linear.
    """

    part: MeshPart
    triangles: AnyInt
    found: Fragments
    colour: Float32
    alpha: Float32
    visible: Bool
    radiance: Float32

    @property
    def normals(self) -> Float32:
        """(V, 3) unit, that the part is lit with."""
        return part_normals(self.part, self.part.vertices, self.triangles)


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
    drawn = []
    for part in parts:
        if part.material.opacity <= 0:
            continue
        triangles, places = part_triangles(part.polygons), part_triangles(part.polygons_uv, part.polygons)
        found = fragments(*seen(part.vertices), triangles, width, height, nearer=nearest)
        if not len(found.pixel):
            continue
        colour, alpha = painted(part, interpolate(part.uv, places[found.triangle], found.barycentric), chart_albedo)
        lit = np.zeros((len(alpha), 3), np.float32)
        drawn.append(_Drawn(part, triangles, found, colour, alpha, np.ones(len(alpha), bool), lit))
    if not drawn:
        return np.zeros((height * width, 4), np.float32)
    pixel = np.concatenate([one.found.pixel for one in drawn])
    order = np.lexsort((np.concatenate([one.found.depth for one in drawn]), pixel))
    reached = np.zeros(len(pixel), np.float32)
    reached[order] = transmittances(pixel[order], np.concatenate([one.alpha for one in drawn])[order])
    first = 0
    for one in drawn:
        one.visible = reached[first : first + len(one.alpha)] > HIDDEN
        first += len(one.alpha)
        if recess_of(one.part.name) is None:
            lit = light.on(one.part.vertices, one.normals)
            shade = interpolate(lit, one.triangles[one.found.triangle], one.found.barycentric)
            one.radiance = srgb_to_linear(one.colour) * shade
    for name in RECESSES:
        inside = [one for one in drawn if recess_of(one.part.name) == name and one.visible.any()]
        if inside:
            own = [part for part in parts if recess_of(part.name) == name]
            recess = Recess.of(own, head, vertices, light.visibility.casts, light.visibility.detail)
            around = np.concatenate([light.albedo, np.float32(np.pi) * light.radiance], 1)
            _light_recess(inside, recess, skin_around(own, light.samples.position_m, around), light)
    colour, alpha = (np.concatenate(a) for a in zip(*((one.radiance, one.alpha) for one in drawn), strict=True))
    return composite(pixel[order], colour[order], alpha[order], width * height)


def _light_recess(drawn: Sequence[_Drawn], recess: Recess, skin: Float32, light: PartLight) -> None:
    """Set the radiance of visible fragments of parts in a recess whose flesh has an albedo (3,), and alpha of clear
    parts: what they do not mirror goes through.
    """
    grids = [
        Nodes.of(
            one.part.vertices, one.normals, one.triangles,
            one.found.triangle[one.visible].astype(np.int64), one.found.barycentric[one.visible],
        )
        for one in drawn
    ]  # fmt: skip
    points, normals = (np.concatenate(a) for a in zip(*((grid.points, grid.normals) for grid in grids), strict=True))
    whole = recess.arriving(points, normals, light.viewpoint, light.light, light.plan, light.graphs)
    first = 0
    for one, grid in zip(drawn, grids, strict=True):
        there = whole.at(grid, first)
        first += len(grid.points)
        arriving, flesh = there.with_flesh(skin[:3], skin[3:])
        mirrored, kept = light.glossy(grid, there, one.part.material, flesh)
        if one.part.material.transmission > 0:
            cover = np.maximum(1 - kept, np.float32(1e-6))
            one.radiance[one.visible], one.alpha[one.visible] = mirrored / cover[:, None], cover
            continue
        diffuse = srgb_to_linear(one.colour[one.visible]) * arriving / np.float32(np.pi)
        one.radiance[one.visible] = diffuse * kept[:, None] + mirrored
