"""The light stage's camera: skin, head and scene -> a photo-like texture with the light baked in (method.md 2.2).

For every texel and viewpoint: diffuse light that scattered under the skin, highlights of the lamps, the mirror image of
the surroundings, shadows on all of them; then the camera's response; then a blend of the viewpoints, as textures are
stitched from photos. What the skin mirrors is missing from what it scatters, so no light is gained.
"""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor

from models.lightstage.light import relief, scatter
from models.lightstage.light.geometry import Geometry, Site
from models.lightstage.light.harmonics import basis
from models.lightstage.light.lobes import Gloss, directional_albedo, fresnel, ggx
from models.lightstage.light.maps import LitMaps
from models.lightstage.light.reflection import Mirror, mirror_of
from models.lightstage.light.response import developed
from models.lightstage.light.sampling import dot, unit
from models.lightstage.skin.window import ChartWindow
from service.errors import UsageError
from service.light.environment import Illumination, flux_by_direction, illumination
from service.light.formulas import COSINE_LOBE, SMALLEST_ALPHA, project
from service.light.plan import LightPlan
from service.light.scene import PointLight, Scene

_NEAREST_M = 1e-3

@dataclasses.dataclass(frozen=True)
class Lamp:
    """A light at the texels.

    Unit direction (3, h, w), distance (h, w) in m, irradiance (3, h, w) when facing, shade (h, w).
    """

    towards: Tensor
    distance: Tensor
    irradiance: Tensor
    shade: Tensor
    size: Tensor


def footprint(window: ChartWindow, geometry: Geometry, plan: LightPlan, scatter_scale: float = 1.0) -> ChartWindow:
    """The window that maps must cover for a crop to come out as it does in the whole chart."""
    densest = geometry.density(window)
    halo, multiple = 0, 1
    if plan.runs("scattering"):
        halo, multiple = scatter.reach(densest, scatter_scale), scatter.alignment(densest, scatter_scale)
    if any(d.effect == "relief_shadows" and d.runs for d in plan.decisions):
        halo += relief.reach(densest)
    return window.grown(halo, multiple)


def bake(
    skin: LitMaps,
    geometry: Geometry,
    scene: Scene,
    plan: LightPlan,
    window: ChartWindow,
    *,
    maps_window: ChartWindow | None = None,
    scatter_scale: float = 1.0,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """(3, h, w) sRGB-coded texture in [0, 1] of a window; the same for the same input on every machine, to rounding.

    Args:
        skin: maps of ``maps_window``.
        geometry: the head, on the same device.
        scene: with a number for its exposure.
        plan: effects that run, made for this scene.
        window: what to bake.
        maps_window: what the maps show; ``footprint`` tells what an exact crop needs. By default ``window`` itself:
            light that would have scattered in from beyond is then taken to be that of the border.
        scatter_scale: width of the scattering profile relative to the published one.
        dtype: of highlights, mirror image and response: float32 or bfloat16. Directions are always float32.

    Raises:
        UsageError: maps of another size than their window, no exposure.
        KeyError: the plan was made for another scene.
    """
    outer = maps_window or window
    views = radiance(skin, geometry, scene, plan, outer, scatter_scale=scatter_scale, dtype=dtype)
    total = torch.zeros((), dtype=torch.float32, device=geometry.device)
    for light, weight in views:
        total = total + weight * developed(light, scene.response).float()
    return window.cut(total, outer).to(dtype)


def radiance(
    skin: LitMaps,
    geometry: Geometry,
    scene: Scene,
    plan: LightPlan,
    window: ChartWindow,
    *,
    scatter_scale: float = 1.0,
    dtype: torch.dtype = torch.float32,
) -> list[tuple[Tensor, Tensor]]:
    """Linear light (3, h, w) >= 0 towards each viewpoint and the viewpoint's weight (h, w); weights add to 1."""
    wanted = (window.height, window.width)
    if tuple(skin.diffuse_albedo.shape[-2:]) != wanted:
        raise UsageError(f"maps of {tuple(skin.diffuse_albedo.shape[-2:])} texels for a window of {wanted}")
    light = illumination(scene)
    site = geometry.site(window)
    lamps = [_lamp(skin, geometry, site, item, i, plan, window) for i, item in enumerate(light.lights)]
    diffuse = _diffuse(skin, geometry, site, light, lamps, plan, window, scatter_scale)
    normal = site.to_head(skin.specular_normal)
    gloss = Gloss.of(skin.specular_albedo.to(dtype), skin.roughness.to(dtype), plan.runs("second_lobe"))
    openness = geometry.openness(window) if plan.runs("occlusion") and not light.dark else None
    result, weights = [], []
    for viewpoint in scene.viewpoints:
        at = torch.tensor(viewpoint, device=geometry.device, dtype=torch.float32).view(3, 1, 1) * 1000.0
        view = unit(at - site.position)
        result.append(_towards(view, normal, gloss, diffuse, lamps, light, openness, plan))
        weights.append(dot(site.normal, view).clamp(min=0.02) ** 4)
    total = torch.stack(weights).sum(0)
    return [(r, w / total) for r, w in zip(result, weights, strict=True)]


def _lamp(
    skin: LitMaps, geometry: Geometry, site: Site, light: PointLight, index: int, plan: LightPlan, window: ChartWindow
) -> Lamp:
    towards, distance, irradiance, size = arriving_at(site.position, *sent_by(light, geometry.device))
    shade = torch.ones_like(distance)
    if plan.runs("shadows", index):
        shade = geometry.shadow(light, window)
    if plan.runs("relief_shadows", index):
        local = torch.stack([dot(towards, axis) for axis in (site.tangent, site.bitangent, site.normal)])
        shade = shade * relief.relief_shadow(skin.height_mm, local, site)
    return Lamp(towards, distance, irradiance, shade, size)


def sent_by(light: PointLight, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Position (3,) in m, intensity (3,) and radius () in m of a lamp."""
    numbers = (light.position_m, light.intensity, light.radius_m)
    at, intensity, radius = (torch.tensor(each, device=device, dtype=torch.float32) for each in numbers)
    return at, intensity, radius


def arriving_at(
    position: Tensor, at: Tensor, intensity: Tensor, radius: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What a ball sends to (3, h, w) positions in mm if nothing is in the way.

    Returns:
        Unit direction (3, h, w), distance (h, w) in m, irradiance (3, h, w) when facing it, sine of its angular radius.
    """
    offset = at.view(3, 1, 1) - position / 1000.0
    distance = offset.square().sum(0).sqrt()
    fall = 1.0 / torch.maximum(distance * distance, (radius * radius).clamp(min=_NEAREST_M**2))
    size = (radius / distance.clamp(min=_NEAREST_M)).clamp(1e-6, 1.0)
    return unit(offset), distance, intensity.view(3, 1, 1) * fall, size


def facing(cosine: Tensor, size: Tensor) -> Tensor:
    """Irradiance factor of a ball of sine ``size`` whose centre is at ``cosine``, part of it below the horizon."""
    wrapped = (cosine + size).square() / (4.0 * size)
    return torch.where(cosine.abs() < size, wrapped, cosine.clamp(min=0.0))


def _diffuse(
    skin: LitMaps, geometry: Geometry, site: Site, light: Illumination, lamps: list[Lamp], plan: LightPlan,
    window: ChartWindow, scale: float,
) -> Tensor:  # fmt: skip
    """(3, h, w) light that leaves the skin after scattering, before the surface takes its part."""
    normal = site.to_head(skin.diffuse_normal)
    arriving = torch.zeros_like(site.position)
    if not light.dark:
        arriving = _sky(geometry, normal, light, plan.runs("occlusion"), window)
    for lamp in lamps:
        arriving = arriving + lamp.irradiance * (lamp.shade * facing(dot(normal, lamp.towards), lamp.size))
    albedo = skin.diffuse_albedo.float().clamp(0.0, 1.0)
    if not plan.runs("scattering"):
        return albedo * arriving / math.pi
    root = albedo.sqrt()
    mask = skin.mask[0].float()
    spread = scatter.scattered(root * arriving, site.texels_per_mm, mask, geometry.density(window), scale)
    return root * spread / math.pi


def _sky(geometry: Geometry, normal: Tensor, light: Illumination, occlusion: bool, window: ChartWindow) -> Tensor:
    """(3, h, w) irradiance of the surroundings."""
    if occlusion:
        flux = torch.from_numpy(flux_by_direction(light.sky, len(geometry.visible))).to(geometry.device)
        vector = geometry.sky_light(flux, window).view(3, 3, *normal.shape[1:])
        return (vector * normal).sum(1).clamp(min=0.0)
    factors = torch.from_numpy(COSINE_LOBE[:, None] * project(light.sky)).float().to(geometry.device)
    return torch.einsum("khw,kc->chw", basis(normal), factors).clamp(min=0.0)


def _towards(
    view: Tensor, normal: Tensor, gloss: Gloss, diffuse: Tensor, lamps: list[Lamp], light: Illumination,
    openness: Tensor | None, plan: LightPlan,
) -> Tensor:  # fmt: skip
    """(3, h, w) light towards one viewpoint."""
    dtype = gloss.f0.dtype
    mirror = plan.runs("reflection") and not light.dark
    shining = [lamp for i, lamp in enumerate(lamps) if plan.runs("specular", i)]
    if not (mirror or shining):
        return diffuse.to(dtype) * (1.0 - gloss.f0)
    cosine = dot(normal, view)
    n_v = cosine.clamp(1e-3, 1.0).to(dtype)
    rising = plan.runs("fresnel")
    lobes = zip(gloss.alphas, gloss.shares, strict=True)
    parts = [directional_albedo(gloss.f0, a, n_v, rising=rising) * w for a, w in lobes]
    kept = 1.0 - torch.stack(parts).sum(0).clamp(0.0, 1.0)
    total = diffuse.to(dtype) * kept
    for lamp in shining:
        total = total + highlight(view, normal, gloss, lamp, rising=rising).to(dtype)
    if mirror:
        image = mirror_of(light.sky, normal.device)
        for part, alpha in zip(parts, gloss.alphas, strict=True):
            total = total + mirrored(image, view, normal, part, alpha, openness)
    return total


def mirrored(
    image: Mirror, view: Tensor, normal: Tensor, part: Tensor, alpha: Tensor, openness: Tensor | None
) -> Tensor:
    """(3, h, w) the sky in the mirror of one lobe, whose directional albedo is ``part`` (h, w).

    ``openness`` (h, w) is ambient occlusion; None where nothing hides the sky, which is the same as 1.
    """
    cosine = dot(normal, view)
    seen = part * image.seen(unit(2.0 * cosine * normal - view), alpha).to(part.dtype)
    if openness is None:
        return seen
    return seen * _mirror_openness(openness, cosine.clamp(1e-3, 1.0), alpha.float()).to(part.dtype)


def _mirror_openness(openness: Tensor, n_v: Tensor, alpha: Tensor) -> Tensor:
    """Occlusion of a lobe from ambient occlusion (Lagarde and de Rousiers 2014)."""
    power = 2.0 ** (-16.0 * alpha.clamp(SMALLEST_ALPHA, 1.0).sqrt() - 1.0)
    return ((n_v + openness).clamp(min=0.0) ** power - 1.0 + openness).clamp(0.0, 1.0)


def highlight(view: Tensor, normal: Tensor, gloss: Gloss, lamp: Lamp, *, rising: bool) -> Tensor:
    """(3, h, w) mirror-like reflection of a lamp."""
    dtype = gloss.f0.dtype
    n_v = dot(normal, view).clamp(1e-3, 1.0).to(dtype)
    half = unit(view + lamp.towards)
    sine2 = torch.linalg.cross(normal, half, dim=0).square().sum(0).clamp(0.0, 1.0)
    # Behind the surface the sine comes down again; the horizon factor below removes those anyway.
    sine2 = torch.where(dot(normal, half) > 0.0, sine2, 1.0)
    arriving = facing(dot(normal, lamp.towards), lamp.size)
    n_l = arriving.clamp(0.0, 1.0).to(dtype)
    lobes = torch.zeros_like(gloss.f0)
    widening = (lamp.size * lamp.size / 8.0).to(dtype)
    for alpha, share in zip(gloss.alphas, gloss.shares, strict=True):
        # A ball of angular radius r blurs the half vector by r / 2: in slope variance, alpha^2 grows by r^2 / 8.
        lobes = lobes + share * ggx((alpha * alpha + widening).clamp(max=1.0).sqrt(), sine2.to(dtype), n_l, n_v)
    shine = fresnel(gloss.f0, dot(view, half).to(dtype)) if rising else gloss.f0
    return lamp.irradiance * (lamp.shade * arriving * (lobes * shine).float())
