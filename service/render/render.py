"""Render an archive under a scene: all steps on one page.

::

    archive --open--> mesh, maps --reduce--> Surface --sample--> plan --shade--> radiance --develop--> PNG
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from service.archive.images import encode_png
from service.archive.reading import AvatarFile, StoredMap, open_avatar
from service.archive.surfaces import subdivided_head
from service.arrays import AnyFloat, Float32, Float64, Int64
from service.colour import linear_to_srgb, to_bytes
from service.errors import NumericFault
from service.geometry.camera import Camera
from service.geometry.normals import normalise
from service.geometry.subdivide import Subdivision
from service.head.files import triangle_fields
from service.head.model import HeadModel
from service.light.environment import Illumination, illumination, lookup
from service.light.environment import radiance as environment_radiance
from service.light.formulas import Graphs
from service.light.plan import Plan, plan
from service.light.samples import AZIMUTHS, Index, LitChart, SurfaceSamples, survey
from service.light.scene import BRIGHT, Response, Scene, Triple, exposed_for
from service.light.shading import Shading, develop
from service.materials.of_head import material_of
from service.materials.part import MeshPart, framed
from service.render.parts import NO_SHADOWS, mesh_part, parts_layer
from service.render.recess import PartLight
from service.render.request import RenderRequest
from service.render.shade import Clock, Shader
from service.render.surface import LARGEST, ROLES, Surface, build_surface
from service.render.view import Samples, camera_at, pixel_on_chart, viewpoint_of
from service.render.visibility import Detail, Visibility

COUNT = 384
"""Samples of the skin."""
_GOLDEN = 0.6180339887498949
"""Golden ratio less 1: its multiples modulo 1 are spread evenly."""


def samples_of(surface: Surface, visibility: Visibility, seen: Samples) -> SurfaceSamples:
    """Samples of the visible skin, with the density of the picture's pixels."""
    s = surface
    height, width = s.specular.shape
    chart = LitChart(
        position_m=s.position_m,
        normal=s.normal,
        tangent=s.tangent,
        bitangent=s.bitangent,
        diffuse_normal=s.diffuse_normal,
        specular_normal=s.specular_normal,
        albedo=s.albedo,
        specular=s.specular,
        alpha=s.alpha,
        share=s.share,
        texels_per_mm=s.texels_per_mm,
        skin=s.skin,
        weight=_weight(seen, height, width) * s.skin,
    )
    offsets = np.asarray(np.arange(COUNT) * _GOLDEN % 1.0, np.float64)

    def visible(at: Index) -> Float64:
        sky = visibility.sky()
        rows, columns = (at // width) * sky.shape[1] // height, (at % width) * sky.shape[2] // width
        return sky[:, rows, columns].T / 255.0

    flat = np.zeros((COUNT, AZIMUTHS))
    return survey(chart, offsets, visible, lambda at: flat)


def _weight(seen: Samples, height: int, width: int) -> Float64:
    """(H, W) number of the picture's samples nearest to each texel."""
    column = np.clip((seen.uv[:, 0] * width).astype(np.int64), 0, width - 1)
    row = np.clip(((1 - seen.uv[:, 1]) * height).astype(np.int64), 0, height - 1)
    return np.bincount(row * width + column, minlength=height * width).reshape(height, width).astype(np.float64)


def exposed(scene: Scene, surface: SurfaceSamples, light: Illumination) -> Scene:
    """The scene with an exposure that maps the 90th percentile of the samples' luminance to the target.

    A scene that has an exposure is returned unchanged.
    """
    if scene.response.exposure is not None:
        return scene
    return exposed_for(scene, float(np.quantile(Shading(scene, surface, light).luminance(), BRIGHT)))


_BAND = 64
"""Rows of the background computed at once."""


def resolved(
    radiance: Float32, index: Int64, shape: tuple[int, int], supersampling: int, before: Float32 | None = None
) -> tuple[Float32, Float32]:
    """Mean of the samples of each pixel (box filter).

    Args:
        radiance: (N, 3) of the samples on the head.
        index: (N,) flat positions of these samples.
        shape: rows and columns of samples.
        supersampling: samples per pixel and axis.
        before: (rows * columns, 4) radiance times coverage, and coverage, of what stands before the head in each
            sample; None: nothing.

    Returns:
        (h, w, 3) linear radiance times coverage, and (h, w) coverage of the pixel in [0, 1].
    """
    samples = np.zeros((shape[0] * shape[1], 4), np.float32)
    samples[index, :3], samples[index, 3] = radiance, 1.0
    if before is not None:
        samples *= 1 - before[:, 3:]
        samples += before
    split = (shape[0] // supersampling, supersampling, shape[1] // supersampling, supersampling, 4)
    mean = samples.reshape(split).mean((1, 3))
    return mean[..., :3], mean[..., 3]


def behind(camera: Camera, environment: AnyFloat) -> Float32:
    """(h, w, 3) linear radiance of a latitude-longitude image in the direction of each pixel."""
    result = np.zeros((camera.height, camera.width, 3), np.float32)
    x = (np.arange(camera.width) + 0.5 - camera.principal_point[0]) / camera.focal_px
    for first in range(0, camera.height, _BAND):
        rows = np.arange(first, min(first + _BAND, camera.height))
        y = (rows + 0.5 - camera.principal_point[1]) / camera.focal_px
        plane = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones((len(rows), len(x)))], -1)
        result[rows[0] : rows[-1] + 1] = lookup(np.asarray(environment, np.float64), normalise(plane @ camera.rotation))
    return result


def coded(light: Float32, covered: Float32, response: Response, background: Float32 | None, *, alpha: bool) -> bytes:
    """PNG bytes, 8-bit sRGB.

    Args:
        light: (h, w, 3) linear, as from :func:`resolved`.
        covered: (h, w) in [0, 1].
        response: tone curve, with a number for its exposure.
        background: (h, w, 3) linear radiance behind the head; None for none.
        alpha: add ``covered`` as alpha channel; colours are then not premultiplied.
    """
    if alpha:
        whole = light / np.maximum(covered, np.float32(1e-6))[..., None]
        colour = to_bytes(develop(whole.astype(np.float64), response) * (covered > 0)[..., None])
        return encode_png(np.dstack([colour, to_bytes(covered)]), srgb=True)
    behind_it = 0.0 if background is None else (1 - covered)[..., None] * background
    return encode_png(to_bytes(develop((light + behind_it).astype(np.float64), response)), srgb=True)


MOST_POLYGONS = 20_000
"""Largest mesh that is subdivided before rendering; an archive's has about 4,500 polygons."""

NO_RELIEF = "relief-shadows-not-simulated"
"""Fallback: displacement maps are not read, as the decode gate returns 8 bits, too few for relief."""


@dataclass(frozen=True)
class Picture:
    """One picture and how it was made.

    Attributes:
        png: the file.
        light: (h, w, 3) linear radiance of the head before the tone curve, times coverage.
        covered: (h, w) in [0, 1].
        camera: of the picture.
        scene: with the chosen exposure.
        plan: which effects were computed.
        chart: (width, height) of the chart that was lit.
        fallbacks: stable codes of deviations from the request, for example for want of a map.
        timings_s: seconds by step.
    """

    png: bytes
    light: Float32
    covered: Float32
    camera: Camera
    scene: Scene
    plan: Plan
    chart: tuple[int, int]
    fallbacks: tuple[str, ...]
    timings_s: dict[str, float]

    def facts(self) -> dict[str, Any]:
        """As JSON values."""
        camera = self.camera
        runs = [d for d in self.plan.decisions if d.runs]
        return {
            "width": camera.width,
            "height": camera.height,
            "bytes": len(self.png),
            "camera": {
                "viewpoint_m": [round(float(value), 6) for value in camera.centre],
                "focal_px": round(camera.focal_px, 3),
                "principal_point": [round(float(value), 3) for value in camera.principal_point],
            },
            "exposure": self.scene.response.exposure,
            "effects": list(dict.fromkeys(d.effect for d in runs)),
            "plan": [dataclasses.asdict(d) for d in self.plan.decisions],
            "left_out_costs_at_most": round(self.plan.bound, 4),
            "chart": list(self.chart),
            "fallbacks": list(self.fallbacks),
            "timings_s": {name: round(seconds, 4) for name, seconds in self.timings_s.items()},
        }


@dataclass
class Kept:
    """What pictures of one head in one light have in common."""

    surface: Surface | None = None
    size: tuple[int, int] = (0, 0)
    graphs: Graphs | None = None
    visibility: Visibility | None = None


def render_archive(source: Path | IO[bytes], request: RenderRequest, *, threads: int = 2) -> Picture:
    """A picture of the avatar in an archive.

    Args:
        source: path or seekable stream of the archive.
        request: scene, view, size and the like.
        threads: compute threads.

    Raises:
        UsageError: no such file, or a request that is not possible.
        BadArchive, BadMesh: the archive cannot be used, or lacks a map that has no substitute.
        NumericFault: light that is not finite.
    """
    clock = Clock()
    with clock.step("open"):
        avatar = open_avatar(source, ROLES)
    with clock.step("mesh"):
        head, vertices, parts = meshes(avatar)
    return render_head(head, vertices, avatar.maps, request, threads=threads, clock=clock, parts=parts)


def meshes(avatar: AvatarFile) -> tuple[HeadModel, AnyFloat, tuple[MeshPart, ...]]:
    """The smoothed head of an archive without what others replace, its vertices, and the meshes beside its own."""
    whole = without_parts(avatar.mesh.as_head(*named(avatar)), avatar.replaced)
    head, vertices = smoothed(whole, avatar.mesh.vertices)
    return head, vertices, tuple(mesh_part(stored) for stored in avatar.parts)


def smoothed(head: HeadModel, vertices: AnyFloat) -> tuple[HeadModel, AnyFloat]:
    """The head after one step of Catmull-Clark subdivision, so that silhouettes of the skin have no corners.

    Other parts are subdivided without smoothing, which would shrink coarse ones like teeth, and so is the skin at its
    open border, where the bust goes on along the same edges. Meshes of more than ``MOST_POLYGONS`` are returned
    unchanged.
    """
    if len(head.polygons) > MOST_POLYGONS:
        return head, vertices
    fine, smooth = subdivided_head(head, vertices, 1)
    skin = [i for i, name in enumerate(head.part_names) if material_of(name).detailed]
    there = np.zeros(len(smooth), bool)
    there[fine.triangles[np.isin(fine.triangle_part, skin)]] = True
    step = Subdivision.of(head.polygons, len(vertices))
    return fine, np.where((there & ~step.open_points())[:, None], smooth, step.linear(vertices))


def without_parts(head: HeadModel, names: Collection[str]) -> HeadModel:
    """The head without some of its parts; its vertices and chart stay as they are."""
    gone = [index for index, name in enumerate(head.part_names) if name in names]
    kept = ~np.isin(head.polygon_part, gone)
    if kept.all() or not kept.any():
        return head
    rows = head.polygons[kept], head.polygon_uv[kept], head.polygon_part[kept]
    split = triangle_fields(*rows)
    return dataclasses.replace(
        head, polygons=rows[0], polygon_uv=rows[1], polygon_part=rows[2], triangles=split["triangles"],
        triangle_uv=split["triangle_uv"], triangle_part=split["triangle_part"],
    )  # fmt: skip


def named(avatar: AvatarFile) -> tuple[str, str]:
    """Name and licence of an archive's head model."""
    head = avatar.manifest.get("head")
    facts = head if isinstance(head, dict) else {}
    return str(facts.get("name", "head")), str(facts.get("licence", "unknown"))


def render_head(
    head: HeadModel,
    vertices: AnyFloat,
    maps: dict[str, StoredMap],
    request: RenderRequest,
    *,
    threads: int = 2,
    detail: Detail = Detail(),  # noqa: B008 - frozen
    camera: Camera | None = None,
    without: tuple[str, ...] = (),
    clock: Clock | None = None,
    parts: Sequence[MeshPart] = (),
    kept: Kept | None = None,
) -> Picture:
    """A picture of a head with its maps; raises as :func:`render_archive`.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres, head space.
        maps: packed maps by role.
        request: scene, view, size and the like.
        threads: compute threads.
        detail: resolution of the visibility.
        camera: in place of the request's; of the request's size.
        without: effects to leave out regardless of the plan, for comparisons.
        clock: holds the times of earlier steps.
        parts: meshes beside the head's own, with textures of their own.
        kept: keeps what does not depend on the camera for the next picture of the same head.
    """
    clock = clock or Clock()
    viewpoint = _centre(camera) if camera else viewpoint_of(request.view, request.scene.viewpoints)
    scene = dataclasses.replace(request.scene, viewpoints=(viewpoint,))
    light = illumination(scene)  # an unknown environment is refused before the maps are unpacked
    camera = camera or camera_at(viewpoint, framed(vertices, parts), *request.size)
    size = _chart_size(head, vertices, camera, detail.narrowest)
    kept = kept or Kept()
    with clock.step("maps"):
        surface = kept.surface if kept.surface is not None and kept.size >= size else None
        size = kept.size if surface is not None else size
        kept.surface = surface = surface or build_surface(head, vertices, maps, size)
        kept.size = size
    with clock.step("samples"):
        samples = Samples.of(head, vertices, camera, request.samples)
    kept.graphs = graphs = kept.graphs or Graphs(threads)
    kept.visibility = visibility = kept.visibility or Visibility(head, vertices, graphs, detail)
    with clock.step("sky"):
        visibility.sky()
    with clock.step("plan"):
        points = samples_of(surface, visibility, samples)
        scene = exposed(scene, points, light)
        chosen = _simulated(plan(scene, points, request.tolerance), without)
    shader = Shader(surface, visibility, light, chosen, graphs, clock)
    radiance = shader.radiance(samples, viewpoint)
    if not np.isfinite(radiance).all():
        raise NumericFault(f"{int((~np.isfinite(radiance)).sum())} values of the picture's light are not finite")
    with clock.step("develop"):
        before = None
        if parts:
            albedo = to_bytes(linear_to_srgb(surface.albedo))
            seen = samples.read(surface.albedo), np.maximum(radiance, 0.0)
            part_light = PartLight(light, chosen, graphs, visibility, viewpoint, samples, *seen)
            before = parts_layer(parts, head, vertices, camera, part_light, albedo, request.samples)
        radiance = np.maximum(radiance, 0.0)
        picture, covered = resolved(radiance, samples.index, samples.shape, request.samples, before)
        background = None
        if request.background == "environment":
            background = behind(camera, environment_radiance(scene.environment))
        png = coded(picture, covered, scene.response, background, alpha=request.background == "transparent")
    fallbacks = _fallbacks(surface, request, len(light.lights)) + ((NO_SHADOWS,) if parts else ())
    return Picture(png, picture, covered, camera, scene, chosen, size, fallbacks, clock.seconds)


def _centre(camera: Camera) -> Triple:
    x, y, z = (float(value) for value in camera.centre)
    return x, y, z


def _simulated(made: Plan, without: tuple[str, ...]) -> Plan:
    """The plan without relief shadows, which are not computed here (``NO_RELIEF``), and without some effects."""
    known = (d for d in made.decisions if d.effect != "relief_shadows")
    left = (dataclasses.replace(d, runs=d.runs and d.effect not in without) for d in known)
    return Plan(tuple(left), made.tolerance)


def _chart_size(head: HeadModel, vertices: AnyFloat, camera: Camera, narrowest: int) -> tuple[int, int]:
    """Smallest size, ``narrowest`` times a power of two, whose texels are no larger than the picture's pixels."""
    pixel = pixel_on_chart(head, vertices, camera)
    width = narrowest
    while width < LARGEST and pixel > 0 and width * pixel < 1.0:
        width *= 2
    return width, width * 2 // 3


def _fallbacks(surface: Surface, request: RenderRequest, lamps: int) -> tuple[str, ...]:
    several = ("viewpoints-but-first-ignored",) if request.view is None and len(request.scene.viewpoints) > 1 else ()
    return (
        *surface.fallbacks,
        *((NO_RELIEF,) if lamps else ()),
        *several,
    )
