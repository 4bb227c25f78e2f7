"""Render a head under a scene: all steps on one page.

::

    maps --reduce--> Surface --see, shade--> radiance --expose, develop--> pixels
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.arrays import AnyFloat, Float32, UInt8
from service.colour import LUMA, to_bytes
from service.errors import NumericFault
from service.geometry.camera import Camera
from service.geometry.mesh import normalise
from service.head.model import HeadModel
from service.light.environment import illumination, lookup
from service.light.environment import radiance as environment_radiance
from service.light.formulas import Graphs
from service.light.scene import BRIGHT, Response, Scene, Triple, develop, exposed_for
from service.materials.part import MeshPart, framed
from service.render.draw import DrawnHead, recess_of, see
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

_BAND = 64
"""Rows of the background computed at once."""


@dataclass(frozen=True)
class RenderedPicture:
    """One picture and how it was made.

    Attributes:
        pixels: (h, w, 3) uint8 sRGB, (h, w, 4) with straight alpha where the background is transparent.
        light: (h, w, 3) linear radiance of the head before the tone curve, times coverage.
        covered: (h, w) in [0, 1].
        camera: of the picture.
        scene: with the chosen exposure.
        chart: (width, height) of the chart that was lit.
        fallbacks: stable codes of deviations from the request, for example for want of a map.
        timings_s: seconds by step.
    """

    pixels: UInt8
    light: Float32
    covered: Float32
    camera: Camera
    scene: Scene
    chart: tuple[int, int]
    fallbacks: tuple[str, ...]
    timings_s: dict[str, float]

    def facts(self) -> dict[str, Any]:
        """As JSON values."""
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
    scattering: bool = True,
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
        scattering: whether light wanders under the skin; for comparisons.
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
        _ = visibility.sky
    radiance = HeadShader(surface, visibility, light, graphs, clock, scattering).radiance(seen, viewpoint)
    if not np.isfinite(radiance).all():
        raise NumericFault(f"{int((~np.isfinite(radiance)).sum())} values of the picture's light are not finite")
    radiance = np.maximum(radiance, 0.0)
    if scene.response.exposure is None:
        scene = exposed_for(scene, _bright(radiance, seen.read(surface.skin.astype(np.float32))[:, 0], scene.response))
    with clock.step("parts"):
        skin = np.concatenate([seen.read(surface.albedo), np.float32(np.pi) * radiance], 1)
        RecessLight(light, graphs, detail, viewpoint, kept.hair).light_parts(seen, skin, visibility.casters)
    with clock.step("develop"):
        picture, covered = seen.resolved(radiance)
        background = None
        if request.background == "environment":
            background = behind(camera, environment_radiance(scene.environment))
        transparent = request.background == "transparent"
        pixels = coded(picture, covered, scene.response, background, alpha=transparent)
    fallbacks = (*surface.fallbacks, *((NO_RELIEF,) if light.lights else ()), *fallbacks)
    if request.view is None and len(request.scene.viewpoints) > 1:
        fallbacks = (*fallbacks, "viewpoints-but-first-ignored")
    lit = surface.specular.shape[::-1]
    return RenderedPicture(pixels, picture, covered, camera, scene, lit, fallbacks, clock.seconds)


def _centre(camera: Camera) -> Triple:
    x, y, z = (float(value) for value in camera.centre)
    return x, y, z


def _bright(radiance: Float32, skin: Float32, response: Response) -> float:
    """White-balanced luminance that a tenth of the skin exceeds.

    Args:
        radiance: (N, 3) linear, of the picture's points.
        skin: (N,) share of skin in [0, 1]; where none is seen, all points count.
        response: has the white balance.
    """
    luminance = radiance @ (np.asarray(response.white_balance, np.float32) * LUMA)
    counted = luminance[skin > 0.5] if (skin > 0.5).any() else luminance
    return float(np.quantile(counted, BRIGHT)) if len(counted) else 0.0


def _chart_size(head: HeadModel, vertices: AnyFloat, camera: Camera, narrowest: int) -> tuple[int, int]:
    """Smallest size, ``narrowest`` times a power of two, whose texels are no larger than the picture's pixels."""
    pixel = pixel_on_chart(head, vertices, camera)
    width = narrowest
    while width < LARGEST and pixel > 0 and width * pixel < 1.0:
        width *= 2
    return width, width * 2 // 3


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
    """(h, w, 3) uint8 sRGB.

    Args:
        light: (h, w, 3) linear, as of :meth:`service.render.draw.Seen.resolved`.
        covered: (h, w) in [0, 1].
        response: tone curve, with a number for its exposure.
        background: (h, w, 3) linear radiance behind the head; None for none.
        alpha: add ``covered`` as alpha channel; colours are then not premultiplied.
    """
    if alpha:
        whole = light / np.maximum(covered, np.float32(1e-6))[..., None]
        colour = to_bytes(develop(whole.astype(np.float64), response) * (covered > 0)[..., None])
        return np.dstack([colour, to_bytes(covered)])
    behind_it = 0.0 if background is None else (1 - covered)[..., None] * background
    return to_bytes(develop((light + behind_it).astype(np.float64), response))
