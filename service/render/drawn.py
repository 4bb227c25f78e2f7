"""A head and the parts beside it as they are drawn: triangles, normals, opacity and colours at places of textures."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, Int32, Int64, UInt8
from service.colour import srgb_to_linear
from service.geometry.mesh import area_normals, normalise, summed, unit
from service.geometry.raster import interpolate
from service.geometry.sampling import sample_chart
from service.head.files import triangle_fields
from service.head.model import HeadModel
from service.materials.material import ChartMap, OwnMap
from service.materials.part import MeshPart, head_parts, material_of, part_normals, part_triangles
from service.render.fibres import StrandTexture, cut, strand_textures

MOUTH = frozenset({"teeth_upper", "teeth_lower", "teeth_upper_gums", "teeth_lower_gums", "tongue", "tongue_body"})
"""Names of the parts in the mouth."""
RECESSES = ("eyes", "mouth")


def recess_of(name: str) -> str | None:
    """The recess that a part lies in, "eyes" or "mouth"; None for parts in the open."""
    if name in MOUTH:
        return "mouth"
    return "eyes" if name.startswith("eye_") else None


@dataclass(frozen=True)
class DrawnPart:
    """A part as it is drawn.

    Attributes:
        part: what it is.
        triangles: (T, 3), and their ``places`` (T, 3) on its texture.
        normals: (V, 3) unit.
        along: (V, 3) unit direction of strands, from root to tip; None where it is no hair.
        fibres: its texture with alpha, whose strands may be finer than a sample; None where it has none.
    """

    part: MeshPart
    triangles: Int32
    places: Int32
    normals: Float32
    along: Float32 | None = None
    fibres: StrandTexture | None = None

    @classmethod
    def of(cls, part: MeshPart, fibres: StrandTexture | None = None) -> DrawnPart:
        """A part."""
        triangles = part_triangles(part.polygons)
        places = part_triangles(part.polygons_uv, part.polygons)
        normals = part_normals(part, part.vertices, triangles)
        return cls(part, triangles, places, normals, _along_v(part, triangles, places), fibres)

    @cached_property
    def corners_uv(self) -> Float32:
        """(T, 3, 2) places of the triangles' corners on the texture."""
        return self.part.uv[self.places]

    @cached_property
    def _cover(self) -> UInt8 | None:
        """(H, W) opacity by its texture; None where it has none."""
        picture, way = self.part.material.colour_map, self.part.material.alpha
        if isinstance(picture, OwnMap) and picture.has_alpha and way != "opaque":
            return np.ascontiguousarray(picture.pixels[..., 3])  # sampled many times
        return None

    def opacity(self, uv: Float32) -> Float32:
        """(N,) alpha in [0, 1] at places (N, 2) of its texture."""
        alpha = np.full(len(uv), self.part.material.opacity, np.float32)
        if self._cover is not None:
            alpha *= sample_chart(self._cover, uv)[:, 0] / np.float32(255)
        return cut(alpha, self.part.material)

    def strands(self, corners: Int32, weights: Float32, uv: Float32) -> Float32 | None:
        """(F, 3) unit direction of the strands that the texture shows at places (F, 2); None where it is no hair."""
        if self.along is None:
            return None
        along = unit(interpolate(self.along, corners, weights))
        picture = self.part.material.anisotropy_map
        if not isinstance(picture, OwnMap):
            return along
        normal = unit(interpolate(self.normals, corners, weights))
        code = sample_chart(picture.pixels, uv)[:, :2] / np.float32(127.5) - 1
        across = code[:, :1] * np.cross(along, normal) + code[:, 1:] * along
        return unit(np.cross(normal, across).astype(np.float32))


def _along_v(part: MeshPart, triangles: Int32, places: Int32) -> Float32 | None:
    """(V, 3) unit vectors along which v grows; None where the material knows no strands."""
    if part.material.anisotropy <= 0:
        return None
    uv, points = part.uv.astype(np.float64)[places], part.vertices.astype(np.float64)
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    e1, e2 = points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    turn = np.sign(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])[:, None]
    each: Float64 = turn * (d1[:, :1] * e2 - d2[:, :1] * e1)
    whole = summed(triangles.ravel(), np.repeat(each, 3, 0), len(points))
    return np.asarray(normalise(whole, (0.0, -1.0, 0.0)), np.float32)


@dataclass(frozen=True)
class DrawnHead:
    """A head and everything beside it, as they are drawn.

    Attributes:
        head: the skin alone.
        vertices: (V, 3) metres.
        parts: all others that are visible.
    """

    head: HeadModel
    vertices: AnyFloat
    parts: tuple[DrawnPart, ...]

    @classmethod
    def of(cls, head: HeadModel, vertices: AnyFloat, parts: Sequence[MeshPart] = ()) -> DrawnHead:
        """Split a head into its skin and the rest.

        What is invisible or replaced by a part is left out. The head's own eyes, teeth and tongue become parts, as they
        are lit where they lie (``service.render.recess``).
        """
        replaced = {name for part in parts for name in part.replaces}
        inside = {name for name in head.part_names if recess_of(name)} - replaced
        still = dataclasses.replace(head, expression_names=(), expression=head.expression[:0])
        own = [part for part in head_parts(still, vertices, vertices) if part.name in inside] if inside else []
        shown = [*own, *(part for part in parts if part.material.opacity > 0)]
        drawn = [DrawnPart.of(part, one) for part, one in zip(shown, strand_textures(shown), strict=True)]
        hidden = {name for name in head.part_names if material_of(name).opacity <= 0}
        return cls(without_parts(head, replaced | inside | hidden), vertices, tuple(drawn))

    @cached_property
    def normals(self) -> Float32:
        """(V, 3) unit normals of the head's vertices."""
        return area_normals(self.vertices, self.head.triangles)


def without_parts(head: HeadModel, names: Collection[str]) -> HeadModel:
    """The head without some of its parts; its vertices and chart stay as they are."""
    gone = [index for index, name in enumerate(head.part_names) if name in names]
    kept = ~np.isin(head.polygon_part, gone)
    if kept.all() or not kept.any():
        return head
    polygons, places, part = head.polygons[kept], head.polygon_uv[kept], head.polygon_part[kept]
    fields: dict[str, Any] = triangle_fields(polygons, places, part)
    return dataclasses.replace(head, polygons=polygons, polygon_uv=places, polygon_part=part, **fields)


def painted(part: MeshPart, uv: Float32, chart: Float32 | None) -> Float32:
    """(N, 3) linear albedo of a part at places (N, 2) of its texture, or of the chart's."""
    picture = part.material.colour_map
    if isinstance(picture, ChartMap) and chart is not None:
        return sample_chart(chart, uv)
    if isinstance(picture, OwnMap):
        values = sample_chart(picture.pixels, uv) / np.float32(255)
        return srgb_to_linear(values[:, :3] if values.shape[1] >= 3 else np.repeat(values[:, :1], 3, 1))
    return np.tile(np.array(part.material.colour, np.float32), (len(uv), 1))


def bent(drawn: DrawnPart, shown: Int64, inside: Float32, uv: Float32) -> Float32 | None:
    """(F, 3) unit normals of a recessed part's own map at places (F, 2), about those of its mesh; None without such a
    map.

    ``shown`` (F,) are its triangles and ``inside`` (F, 3) the barycentric coordinates there.
    """
    picture = drawn.part.material.normal_map
    if not isinstance(picture, OwnMap) or recess_of(drawn.part.name) is None:
        return None
    normal = normalise(interpolate(drawn.normals, drawn.triangles[shown], inside))
    corners, places = drawn.part.vertices[drawn.triangles], drawn.part.uv[drawn.places]
    (a, b), (s, t) = ((rows[:, 1] - rows[:, 0], rows[:, 2] - rows[:, 0]) for rows in (corners, places))
    along = (a * t[:, 1:] - b * s[:, 1:])[shown] * np.sign(s[:, :1] * t[:, 1:] - s[:, 1:] * t[:, :1])[shown]
    tangent = normalise(along - normal * (along * normal).sum(1, keepdims=True), (1.0, 0.0, 0.0))
    local = (sample_chart(picture.pixels[..., :3], uv) - np.float32(128)) / np.float32(127)
    bitangent = np.cross(normal, tangent)
    made = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * normal
    return np.asarray(normalise(made), np.float32)
