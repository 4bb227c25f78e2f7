"""Render a head under a scene: all steps on one page.

::

    maps --reduce--> Surface --see--> plan --shade--> radiance --develop--> pixels
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import luma, to_bytes
from service.errors import NumericFault
from service.geometry.camera import Camera
from service.geometry.mesh import normalise
from service.head.model import HeadModel
from service.light.environment import illumination, lookup
from service.light.environment import radiance as environment_radiance
from service.light.formulas import Graphs
from service.light.plan import LightPlan, plan
from service.light.samples import AZIMUTHS, Index, SurfaceSamples, survey
from service.light.scene import BRIGHT, Response, Scene, Triple, exposed_for
from service.light.shading import Shading, develop
from service.materials.part import MeshPart, framed
from service.render.draw import SeenHead, see
from service.render.drawn import DrawnHead, recess_of
from service.render.recess import RecessLight
from service.render.request import RenderRequest
from service.render.shade import Clock, HeadShader
from service.render.strands import HairVolume
from service.render.surface import LARGEST, StoredMap, Surface, build_surface
from service.render.view import camera_at, pixel_on_chart, viewpoint_of
from service.render.visibility import Visibility, VisibilityDetail

NO_RELIEF = "relief-shadows-not-simulated"
"""Fallback: displacement maps are not read, as the decode gate returns 8 bits, too few for relief."""
NO_SHADOWS = "part-shadows-not-simulated"
"""Fallback: lashes and brows throw no shadows in the picture."""

COUNT = 384
"""Samples of the skin for the planner."""
_GOLDEN = 0.6180339887498949
"""Golden ratio less 1: its multiples modulo 1 are spread evenly."""
_BAND = 64
"""Rows of the background computed at once."""
BRIGHTER = 1.25
"""How much brighter than its bare skin, for which a picture is exposed, the whole head may be."""


@dataclass(frozen=True)
class RenderedPicture:
    """One picture and how it was made.

    Attributes:
        pixels: (h, w, 3) uint8 sRGB, (h, w, 4) with straight alpha where the background is transparent.
        light: (h, w, 3) linear radiance of the head before the tone curve, times coverage.
        covered: (h, w) in [0, 1].
        camera: of the picture.
        scene: with the chosen exposure.
        plan: which effects were computed.
        chart: (width, height) of the chart that was lit.
        fallbacks: stable codes of deviations from the request, for example for want of a map.
        timings_s: seconds by step.
    """

    pixels: UInt8
    light: Float32
    covered: Float32
    camera: Camera
    scene: Scene
    plan: LightPlan
    chart: tuple[int, int]
    fallbacks: tuple[str, ...]
    timings_s: dict[str, float]

    def facts(self) -> dict[str, Any]:
        """How the picture was made, as JSON values."""
        camera = self.camera
        return {
            "width": camera.width,
            "height": camera.height,
            "camera": {
                "viewpoint_m": [round(float(value), 6) for value in camera.centre],
                "focal_px": round(camera.focal_px, 3),
                "principal_point": [round(float(value), 3) for value in camera.principal_point],
            },
            "exposure": self.scene.response.exposure,
            "effects": list(dict.fromkeys(d.effect for d in self.plan.decisions if d.runs)),
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
    visibility: Visibility | None = None
    hair: HairVolume | None = None


def render_head(
    head: HeadModel,
    vertices: AnyFloat,
    maps: Mapping[str, StoredMap],
    request: RenderRequest,
    *,
    threads: int = 2,
    detail: VisibilityDetail = VisibilityDetail(),  # noqa: B008 - frozen
    camera: Camera | None = None,
    without: tuple[str, ...] = (),
    clock: Clock | None = None,
    parts: Sequence[MeshPart] = (),
    kept: Kept | None = None,
) -> RenderedPicture:
    """A picture of a head with its maps.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres, head space.
        maps: by role, see ``service.render.surface.ROLES``.
        request: scene, view, size and the like.
        threads: compute threads.
        detail: resolution of the visibility.
        camera: in place of the request's; of the request's size.
        without: effects to leave out regardless of the plan, for comparisons.
        clock: holds the times of earlier steps.
        parts: meshes beside the head's own, with textures of their own.
        kept: keeps what does not depend on the camera for the next picture of the same head.

    Raises:
        UsageError: a request that is not possible.
        BadArchive: a map cannot be read, or one that has no substitute is missing.
        NumericFault: light that is not finite.
    """
    clock, kept = clock or Clock(), kept or Kept()
    viewpoint = _centre(camera) if camera else viewpoint_of(request.view, request.scene.viewpoints)
    scene = dataclasses.replace(request.scene, viewpoints=(viewpoint,))
    light = illumination(scene)  # an unknown environment is refused before the maps are decoded
    camera = camera or camera_at(viewpoint, framed(vertices, parts), *request.size)
    model = DrawnHead.of(head, vertices, parts)
    head = model.head
    fallbacks = (NO_SHADOWS,) if any(part.material.alpha == "blend" for part in parts) else ()
    size = _chart_size(head, vertices, camera, detail.narrowest)
    with clock.step("maps"):
        if kept.surface is None or kept.surface.specular.shape[1] < size[0]:
            kept.surface = build_surface(head, vertices, maps, size)
        surface = kept.surface
    with clock.step("samples"):
        seen = see(model, camera, request.samples, surface.albedo)
    if kept.visibility is None:
        kept.hair = HairVolume.of(model.parts, vertices, head.triangles)
        alone = None if kept.hair is None else kept.hair.alone
        beside = tuple(part for part in parts if part.material.alpha == "opaque" and recess_of(part.name) is None)
        kept.visibility = Visibility(head, vertices, Graphs(threads), detail, alone, beside)
    visibility = kept.visibility
    graphs = visibility.graphs
    with clock.step("sky"):
        sky = visibility.sky
    with clock.step("plan"):
        points = samples_of(surface, sky, seen)
        if scene.response.exposure is None:
            # The 90th percentile of the samples' luminance becomes the response's target.
            scene = exposed_for(scene, float(np.quantile(Shading(scene, points, light).luminance(), BRIGHT)))
        chosen = _simulated(plan(scene, points, request.tolerance), without)
    radiance = HeadShader(surface, visibility, light, chosen, graphs, clock).radiance(seen, viewpoint)
    if not np.isfinite(radiance).all():
        raise NumericFault(f"{int((~np.isfinite(radiance)).sum())} values of the picture's light are not finite")
    radiance = np.maximum(radiance, 0.0)
    with clock.step("parts"):
        skin = np.concatenate([seen.read(surface.albedo), np.float32(np.pi) * radiance], 1)
        RecessLight(light, chosen, graphs, detail, viewpoint, kept.hair).light_parts(seen, skin, visibility.casters)
    with clock.step("develop"):
        picture, covered = seen.resolved(radiance)
        if request.scene.response.exposure is None:
            scene = _no_brighter(scene, picture[covered > 0.5])
        background = None
        if request.background == "environment":
            background = behind(camera, environment_radiance(scene.environment))
        transparent = request.background == "transparent"
        pixels = coded(picture, covered, scene.response, background, alpha=transparent)
    fallbacks = (*surface.fallbacks, *((NO_RELIEF,) if light.lights else ()), *fallbacks)
    if request.view is None and len(request.scene.viewpoints) > 1:
        fallbacks = (*fallbacks, "viewpoints-but-first-ignored")
    lit = surface.specular.shape[::-1]
    return RenderedPicture(pixels, picture, covered, camera, scene, chosen, lit, fallbacks, clock.seconds)


def _no_brighter(scene: Scene, light: Float32) -> Scene:
    """With less exposure where the head as drawn, linear radiance (N, 3), is much brighter than its bare skin: hair may
    hide all of that which is lit.
    """
    seen = luma(light * np.asarray(scene.response.white_balance, np.float32))
    whole = exposed_for(scene, float(np.quantile(seen, BRIGHT)) / BRIGHTER) if seen.size else scene
    return min(scene, whole, key=lambda one: one.response.exposure or 0.0)


def _centre(camera: Camera) -> Triple:
    x, y, z = (float(value) for value in camera.centre)
    return x, y, z


def _simulated(made: LightPlan, without: tuple[str, ...]) -> LightPlan:
    """The plan without relief shadows, which are not computed here (``NO_RELIEF``), and without some effects."""
    known = (d for d in made.decisions if d.effect != "relief_shadows")
    left = (dataclasses.replace(d, runs=d.runs and d.effect not in without) for d in known)
    return LightPlan(tuple(left), made.tolerance)


def _chart_size(head: HeadModel, vertices: AnyFloat, camera: Camera, narrowest: int) -> tuple[int, int]:
    """Smallest size, ``narrowest`` times a power of two, whose texels are no larger than the picture's pixels."""
    pixel = pixel_on_chart(head, vertices, camera)
    width = narrowest
    while width < LARGEST and pixel > 0 and width * pixel < 1.0:
        width *= 2
    return width, width * 2 // 3


def samples_of(surface: Surface, sky: UInt8, seen: SeenHead) -> SurfaceSamples:
    """Samples of the visible skin for the planner, with the density of the picture's points.

    ``sky`` is the (D, h, w) visibility of each direction, 255 = fully visible.
    """
    height, width = surface.specular.shape
    column = np.clip((seen.uv[:, 0] * width).astype(np.int64), 0, width - 1)
    row = np.clip(((1 - seen.uv[:, 1]) * height).astype(np.int64), 0, height - 1)
    weight = np.bincount(row * width + column, minlength=height * width).reshape(height, width)
    offsets = np.asarray(np.arange(COUNT) * _GOLDEN % 1.0, np.float64)

    def visible(at: Index) -> Float64:
        rows, columns = (at // width) * sky.shape[1] // height, (at % width) * sky.shape[2] // width
        return sky[:, rows, columns].T / 255.0

    flat = np.zeros((COUNT, AZIMUTHS))
    return survey(surface, weight.astype(np.float64) * surface.skin, offsets, visible, lambda at: flat)


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


def coded(light: Float32, covered: Float32, response: Response, background: Float32 | None, *, alpha: bool) -> UInt8:
    """(h, w, 3) uint8 sRGB of linear light (h, w, 3) and coverage (h, w) in [0, 1], as of :meth:`SeenHead.resolved`.

    The background is (h, w, 3) linear radiance behind the head; None for none. With ``alpha`` the coverage is a fourth
    channel, and colours are not premultiplied.
    """
    if alpha:
        whole = light / np.maximum(covered, np.float32(1e-6))[..., None]
        colour = to_bytes(develop(whole.astype(np.float64), response) * (covered > 0)[..., None])
        return np.dstack([colour, to_bytes(covered)])
    behind_it = 0.0 if background is None else (1 - covered)[..., None] * background
    return to_bytes(develop((light + behind_it).astype(np.float64), response))
