"""What a camera sees of a head and of the parts beside it: points of both, and their light made pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, Int32, Int64, UInt8
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.camera import Camera
from service.geometry.mesh import area_normals, normalise, summed, unit
from service.geometry.raster import (
    composite,
    fragments,
    interpolate,
    rasterise,
    signed_area,
    transmittances,
)
from service.geometry.sampling import sample_chart
from service.head.files import triangle_fields
from service.head.model import HeadModel
from service.light.environment import Illumination
from service.light.formulas import Graphs, irradiance, lamp_numbers, project
from service.light.scene import WHITE, Triple
from service.materials.material import ChartMap, OwnMap
from service.materials.part import MeshPart, head_parts, material_of, part_normals, part_triangles

MOUTH = frozenset({"teeth_upper", "teeth_lower", "teeth_upper_gums", "teeth_lower_gums", "tongue", "tongue_body"})
"""Names of the parts in the mouth."""
RECESSES = ("eyes", "mouth")

EDGE = 0.15
"""Width of the ramp of alpha around the cutoff of a masked part: a hard step would flicker."""
HIDDEN = 1e-3
"""Share of a fragment's light that reaches the camera below which it is not lit."""
LAYER = 1000
"""Triangles of a part that are drawn at once, from near to far: what lies behind solid cards is left out."""
MIRRORED = 0.02
"""White light that strands mirror on average, over the light on the face: 0.01 below a flash to 0.03 under a clouded
sky, in our own renderer. A photo has it in the colour of hair, of which it is half where hair is black."""
DARKEST = 0.65
"""Factor on linear colours with the photo's light in them at grazing angles; 1 where they face the camera."""


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
    """

    part: MeshPart
    triangles: Int32
    places: Int32
    normals: Float32
    along: Float32 | None = None

    @classmethod
    def of(cls, part: MeshPart) -> DrawnPart:
        """A part."""
        triangles = part_triangles(part.polygons)
        places = part_triangles(part.polygons_uv, part.polygons)
        normals = part_normals(part, part.vertices, triangles)
        return cls(part, triangles, places, normals, _along_v(part, triangles, places))

    @cached_property
    def _cover(self) -> UInt8 | None:
        """(H, W) opacity by its texture; None where it has none."""
        picture, way = self.part.material.colour_map, self.part.material.alpha
        if isinstance(picture, OwnMap) and picture.has_alpha and way != "opaque":
            return np.ascontiguousarray(picture.pixels[..., 3])  # sampled many times
        return None

    def opacity(self, uv: Float32) -> Float32:
        """(N,) alpha in [0, 1] at places (N, 2) of its texture."""
        material = self.part.material
        alpha = np.full(len(uv), material.opacity, np.float32)
        if self._cover is not None:
            alpha *= sample_chart(self._cover, uv)[:, 0] / np.float32(255)
        if material.alpha == "mask":
            alpha = np.clip((alpha - material.cutoff) / np.float32(EDGE) + np.float32(0.5), 0, 1)
        return np.asarray(alpha, np.float32)

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
        drawn = [DrawnPart.of(part) for part in (*own, *(part for part in parts if part.material.opacity > 0))]
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


@dataclass
class SeenPart:
    """Fragments of a part, F of them, hidden ones too.

    Attributes:
        drawn: the part.
        corners: (F, 3) its vertices around each fragment, with barycentric ``weights`` (F, 3).
        pixel: (F,) flat position among the picture's samples.
        colour: (F, 3) linear albedo, and their opacity ``alpha`` (F,).
        radiance: (F, 3) linear; black until somebody lights the part.
        normals: (F, 3) unit, by the part's own normal map; None where it has none.
        along: (F, 3) unit, the strands of hair from root to tip; None of all else.
        uv: (F, 2) places on its texture.
    """

    drawn: DrawnPart
    corners: Int32
    weights: Float32
    uv: Float32
    pixel: Int64
    colour: Float32
    alpha: Float32
    radiance: Float32
    normals: Float32 | None = None
    along: Float32 | None = None

    @property
    def part(self) -> MeshPart:
        """What is seen."""
        return self.drawn.part

    def openness(self) -> Float32:
        """(F, 1) share in [0, 1] of the sky that reaches it by its cavity map; 1 of what has none."""
        cavity = self.part.material.cavity_map
        if not isinstance(cavity, OwnMap):
            return np.ones((len(self.uv), 1), np.float32)
        return sample_chart(cavity.pixels, self.uv) / np.float32(255)

    def between(self, values: Float32) -> Float32:
        """(F, C) of values (V, C) at the part's vertices."""
        return interpolate(values, self.corners, self.weights)


@dataclass(frozen=True)
class SeenHead:
    """The points that a picture shows, N of them on the head.

    Attributes:
        model: what is seen.
        camera: of the picture.
        shape: rows and columns of samples, several per pixel.
        index: (N,) flat position among them.
        corners: (N, 3) vertices around each point, and its barycentric ``weights`` (N, 3).
        uv: (N, 2) on the chart.
        position_m: (N, 3) head space.
        parts: what lies before the head.
        order: of the fragments of all parts, by sample and there from near to far.
    """

    model: DrawnHead
    camera: Camera
    shape: tuple[int, int]
    index: Int64
    corners: Int32
    weights: Float32
    uv: Float32
    position_m: Float32
    parts: tuple[SeenPart, ...]
    order: Int64

    def read(self, image: Float32) -> Float32:
        """(N, C) of a chart image (H, W, C) or (H, W), bilinear, borders repeated."""
        return sample_chart(image, self.uv)

    def recoloured(self, chart: Float32) -> Float32:
        """(N, 3) of another chart image (H, W, 3), which parts that have their colours on the chart take too."""
        for one in self.parts:
            if isinstance(one.part.material.colour_map, ChartMap):
                one.colour = sample_chart(chart, one.uv)
        return self.read(chart)

    def between(self, values: Float32) -> Float32:
        """(N, C) of values (V, C) at the head's vertices."""
        return interpolate(values, self.corners, self.weights)

    def reached(self) -> list[Float32]:
        """(F,) share in [0, 1] of each part's fragments that others leave open."""
        pixel, alpha = self._in_order([one.pixel for one in self.parts]), [one.alpha for one in self.parts]
        share = np.zeros(len(pixel), np.float32)
        share[self.order] = transmittances(pixel, self._in_order(alpha))
        return np.split(share, np.cumsum([len(one) for one in alpha])[:-1])

    def resolved(self, radiance: Float32) -> tuple[Float32, Float32]:
        """(h, w, 3) linear radiance (of the head's points: (N, 3)) times coverage, and (h, w) coverage, means over each
        pixel.

        A sample shows either the head or what goes on from it, as the bust does: no gap is left between two edges that
        are half covered.
        """
        import cv2

        rows, columns = self.shape
        picture = np.zeros((rows * columns, 4), np.float32)
        picture[self.index, :3], picture[self.index, 3] = radiance, 1.0
        if self.parts:
            pixel, colour, alpha = (
                self._in_order(each)
                for each in zip(*((one.pixel, one.radiance, one.alpha) for one in self.parts), strict=True)
            )
            over = composite(pixel, colour, alpha, len(picture))
            picture *= 1 - over[:, 3:]
            picture += over
        size = (self.camera.width, self.camera.height)
        whole = picture.reshape(rows, columns, 4)
        small = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
        return small[..., :3], small[..., 3]

    def _in_order(self, each: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate(each)[self.order]


def see(model: DrawnHead, camera: Camera, samples: float, chart: Float32 | None = None) -> SeenHead:
    """Rasterise a head and the parts beside it, with so many samples per pixel and axis, at least 1.

    1.5 antialiases at half the cost of 2. ``chart`` (h, w, 3) are linear colours, for parts that have theirs on the
    chart.
    """
    width, height = round(camera.width * samples), round(camera.height * samples)

    def projected(points: AnyFloat) -> tuple[Float64, Float64]:
        flat = camera.project(points) * (width / camera.width, height / camera.height)
        return flat, camera.to_camera(points)[:, 2]

    head, vertices = model.head, np.asarray(model.vertices, np.float32)
    raster = rasterise(*projected(model.vertices), head.triangles, width, height, cull=True, perspective=True)
    index = np.flatnonzero(raster.mask)
    triangle, weights = raster.triangle.ravel()[index], raster.barycentric.reshape(-1, 3)[index]
    corners = head.triangles[triangle]
    uv = interpolate(head.uv, head.triangle_uv[triangle], weights)
    position = interpolate(vertices, corners, weights)
    parts, keys = [], [np.zeros(0, np.int64)]
    nearest = raster.depth.copy()
    for drawn in sorted(model.parts, key=lambda one: one.part.material.alpha != "mask"):  # what hides the others first
        flat, depth = projected(drawn.part.vertices)
        double = drawn.part.material.double_sided
        front = np.flatnonzero(double | (signed_area(flat, drawn.triangles) < 0))
        front = front[np.argsort(sum(depth[corner] for corner in drawn.triangles[front].T), kind="stable")]
        for some in np.array_split(front, max(len(front) // LAYER, 1)):
            found = fragments(flat, depth, drawn.triangles[some], width, height, nearer=nearest)
            if not len(found.pixel):
                continue
            shown, pixel = some[found.triangle], found.pixel
            place = interpolate(drawn.part.uv, drawn.places[shown], found.barycentric)
            alpha, inside, far = drawn.opacity(place), found.barycentric, found.depth
            if drawn.part.material.alpha == "mask":
                solid = alpha >= 1
                np.minimum.at(nearest.ravel(), pixel[solid], far[solid])
                kept = np.flatnonzero((alpha > 0) & (far <= nearest.ravel()[pixel]))
                shown, pixel, place = shown[kept], pixel[kept], place[kept]
                alpha, inside, far = alpha[kept], inside[kept], far[kept]
            around, colour = drawn.triangles[shown], painted(drawn.part, place, chart)
            along = drawn.strands(around, inside, place)
            turned = None if along is not None else bent(drawn, shown, inside, place)
            dark = np.zeros_like(colour)
            parts.append(SeenPart(drawn, around, inside, place, pixel, colour, alpha, dark, turned, along))
            keys.append((pixel << 32) | far.view(np.int32))
    # Depths are positive, so their bits are in order.
    order = np.argsort(np.concatenate(keys), kind="stable")
    return SeenHead(model, camera, (height, width), index, corners, weights, uv, position, tuple(parts), order)


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


def open_light(light: Illumination, graphs: Graphs, points: Float32, normals: AnyFloat) -> Float32:
    """(N, 3) linear radiance of a white diffuse surface in the open, where nothing throws shadows.

    Points (N, 3) are in metres, head space, normals (N, 3) unit.
    """
    arriving = np.zeros((3, len(points)), np.float32)
    if not light.dark:
        arriving += irradiance(project(light.sky), normals).T.astype(np.float32)
    at = {
        "position": np.ascontiguousarray(points.T * np.float32(1000)),
        "normal": np.ascontiguousarray(np.asarray(normals, np.float32).T),
        "shade": np.ones(len(points), np.float32),
    }
    for lamp in light.lights:
        arriving += graphs.at_points("irradiance", at, **lamp_numbers(lamp))
    return np.asarray(arriving.T / np.float32(np.pi), np.float32)


def without_gloss(seen: AnyFloat, mirrored: AnyFloat | float = MIRRORED) -> Float32:
    """Albedo of hair from its linear RGB under white light, without what it mirrors; darker than that stays above 0."""
    return np.asarray(np.square(seen) / (seen + np.asarray(mirrored, np.float32)), np.float32)


def with_gloss(albedo: AnyFloat, mirrored: float = MIRRORED) -> Float32:
    """Linear RGB of hair under white light, with what it mirrors: the inverse of :func:`without_gloss`."""
    return np.asarray(0.5 * (albedo + np.sqrt(np.square(albedo) + 4 * np.float32(mirrored) * albedo)), np.float32)


def sketch(
    seen: SeenHead, colour: Float32, light: Illumination | None = None, tint: Triple = WHITE
) -> tuple[Float32, Float32]:
    """A quick picture, lit at the vertices: no shadows but cavity maps, no reflections. As :meth:`SeenHead.resolved`.

    Colours (N, 3) are linear, of the points on the head. Without ``light`` they have the photo's in them, and are only
    darkened at grazing angles; ``tint`` (3,) leads from parts' own colours to those in the photo's light.
    """
    graphs = Graphs(1)

    def at(points: AnyFloat, normals: Float32) -> Float32:
        plain = np.asarray(points, np.float32)
        if light is not None:
            return open_light(light, graphs, plain, normals)
        cosine = np.abs((normals * normalise(seen.camera.centre - plain)).sum(1, keepdims=True))
        return np.asarray(DARKEST + (1 - DARKEST) * cosine, np.float32)

    lit = {id(one.drawn): one.drawn for one in seen.parts}
    light_on = {key: at(drawn.part.vertices, drawn.normals) for key, drawn in lit.items()}
    for one in seen.parts:
        own = np.ones(3) if one.part.material.textured else np.asarray(tint)
        shown = one.colour if one.along is None else with_gloss(one.colour)
        one.radiance = shown * own.astype(np.float32) * one.openness() * one.between(light_on[id(one.drawn)])
    return seen.resolved(colour * seen.between(at(seen.model.vertices, seen.model.normals)))


def over(light: Float32, covered: Float32, backdrop: Float32) -> Float32:
    """(h, w, 3) coded sRGB in [0, 1] of a picture, see :meth:`Seen.resolved`, over a coded backdrop."""
    behind = srgb_to_linear(np.clip(backdrop, 0, 1))
    return linear_to_srgb(np.clip(light + (1 - covered)[..., None] * behind, 0, 1))
