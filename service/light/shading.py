"""Sample points of a surface shaded with and without each effect, by the formulas of ``models/lightstage/light``.

Approximate here and exact there: shadows (visibility in spread directions instead of a depth map per lamp), relief
shadows (sixteen azimuths), scattering (three rings of four points instead of the profile), the sky's reflection (the
same spread directions). A test compares the two point by point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.arrays import Float32, Float64
from service.colour import LUMA
from service.geometry.mesh import normalise
from service.light.environment import Illumination, flux_by_direction, spread_directions
from service.light.formulas import F0_SCALE, Graphs, irradiance, lamp_numbers, mirror_openness, mirror_weights, project
from service.light.samples import AZIMUTHS, SurfaceSamples
from service.light.scene import PointLight, Response, Scene, Triple

Item = tuple[str, int | None]
"""An effect and its light. Four items are assumptions about a light instead of effects, see ``Shading.arriving``."""

DARK, BRIGHT, LOW, GONE = "darkest shadow", "lightest shadow", "lowest relief", "gone"

KINDS = ("both", "one", "flat")
"""Variants of the specular reflection: two lobes, one lobe, two lobes without Fresnel's increase at grazing angles."""

RINGS = np.array([[0.22, 0.53, 0.34], [0.40, 0.02, 0.01], [0.08, 0.0, 0.0]])
"""Weights of the rings of ``RING_MM`` in the diffusion profile, inside out, by colour; the rest is the centre's.

The outermost stands for the widest Gaussian of red alone: the little light it brings into shadow is visible once coded.
"""

HORIZON = 0.25
"""Sine of the angle below the smooth horizon at which a lamp has faded out; above, fine relief may still face it."""

_NEAREST_M = 1e-3
"""Smallest distance in the inverse square law."""
_CONE = np.radians(9.0)
"""Half angle around a lamp over which visibility is averaged."""


def develop(light: Float64, response: Response) -> Float64:
    """(..., 3) coded sRGB in [0, 1] of linear light, by the camera's tone curve."""
    x = np.maximum(light * np.asarray(response.white_balance) * float(response.exposure or 0.0), 0.0)
    if response.shoulder > 0.0:
        knee = 1.0 - response.shoulder
        bent = knee + response.shoulder * -np.expm1(-np.maximum(x - knee, 0.0) / response.shoulder)
        x = np.where(x > knee, bent, x)
    x = np.minimum(x, 1.0)
    coded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.asarray(np.maximum(coded, 0.0) ** response.gamma)


@dataclass
class Lamp:
    """One light on K samples of S places each, P of them with fine relief.

    Attributes:
        irradiance: (S, K, 3) on the diffuse normals, without occlusion.
        facing_irradiance: (K, 3) on a surface that faces the light.
        seen, least, most: (K,) visible share of the light, estimate and extremes over nearby directions.
        relief, lowest: (P, K) share not shadowed by the fine relief, estimate and the lower of two azimuths.
    """

    irradiance: Float64
    facing_irradiance: Float64
    seen: Float64
    least: Float64
    most: Float64
    relief: Float64
    lowest: Float64

    @classmethod
    def of(cls, light: PointLight, s: SurfaceSamples, directions: Float64) -> Lamp:
        """Shade the samples by one light."""
        offset = np.asarray(light.position_m) - s.position
        distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)
        towards = offset / distance[..., None]
        fall = 1.0 / np.maximum(distance**2, max(light.radius_m**2, _NEAREST_M**2))
        size = np.clip(light.radius_m / np.maximum(distance, _NEAREST_M), 1e-6, 1.0)
        light_at = fall[..., None] * np.asarray(light.intensity)
        points = {"position": 1000.0 * s.position, "normal": s.diffuse_normal, "shade": np.ones(distance.shape)}
        irradiance_at = _computed("irradiance", points, **lamp_numbers(light))
        shadow = _shadow(towards[0], size[0], s, directions)
        relief = _relief(towards[0], s)
        return cls(irradiance_at, light_at[0], *shadow, *relief)


_VECTORS = ("position", "normal", "view")
_ONE_THREAD = Graphs(threads=1)


def _graph(name: str, kind: str) -> str:
    return f"{name}_flat" if kind == "flat" else name


def _computed(name: str, points: Mapping[str, Float64], **fixed: Float32) -> Float64:
    """(..., 3) or (...) float64: one of the light stage's formulas evaluated at points (..., 3) and (...)."""
    shape = next(value.shape[:-1] for key, value in points.items() if key in _VECTORS)
    flat = {
        key: np.asarray(value.reshape(-1, 3).T if key in _VECTORS else value.ravel(), np.float32)
        for key, value in points.items()
    }
    result = _ONE_THREAD.at_points(name, flat, **fixed)
    return np.asarray(result.T, np.float64).reshape(*shape, *result.shape[:-1])


def _shadow(
    towards: Float64, size: Float64, s: SurfaceSamples, directions: Float64
) -> tuple[Float64, Float64, Float64]:
    """Mean, least and greatest visibility within a cone about the light."""
    cosine = towards @ directions.T
    near = (cosine > np.cos(np.minimum(_CONE + size, 1.5))[:, None]) & (s.normal @ directions.T > 0.04)
    some = near.any(1)
    best = np.take_along_axis(s.visible, cosine.argmax(1)[:, None], 1)[:, 0]
    seen = np.where(some, (s.visible * near).sum(1) / np.maximum(near.sum(1), 1), best)
    least = np.where(some, np.where(near, s.visible, 1.0).min(1), best)
    most = np.where(some, np.where(near, s.visible, 0.0).max(1), best)
    # Visibility is not known below the smooth horizon; lamps fade out there instead of ending abruptly.
    rise = np.einsum("kx,kx->k", towards, s.normal)
    fade = np.where(rise < np.sin(_CONE) + size, np.clip(1.0 + rise / HORIZON, 0.0, 1.0), 0.0)
    seen, most = np.where(some, seen, np.maximum(seen, 0.5 * fade)), np.maximum(most, fade)
    return seen, least, most


def _relief(towards: Float64, s: SurfaceSamples) -> tuple[Float64, Float64]:
    """(P, K) share of light not shadowed by the relief, by the horizon at the nearest azimuth and the higher of two."""
    x, y, z = (np.einsum("kx,kx->k", towards, axis) for axis in (s.tangent, s.bitangent, s.normal))
    slope = z / np.maximum(np.hypot(x, y), 1e-4)
    turn = np.arctan2(y, x) / (2 * np.pi) * AZIMUTHS
    each = np.arange(len(turn))
    nearest, below = (s.horizon[:, each, at.astype(int) % AZIMUTHS] for at in (np.rint(turn), np.floor(turn)))
    higher = np.maximum(below, s.horizon[:, each, np.ceil(turn).astype(int) % AZIMUTHS])
    return _let_through(slope, nearest), _let_through(slope, higher)


def _let_through(slope: Float64, horizon: Float64) -> Float64:
    # Difference of slopes over which a relief shadow fades in.
    return np.asarray(np.clip((slope - horizon) / 0.08 + 1.0, 0.0, 1.0))


@dataclass
class SeenSamples:
    """Specular light towards one viewpoint; dictionaries by ``KINDS``.

    Attributes:
        highlights: (lights, P, K, 3) radiance.
        mirror: (K, 3) reflected radiance of the sky with specular occlusion; ``mirror_open`` without.
        kept: (K,) share of diffuse light left after specular reflection; ``kept_dull`` without specular effects.
        facing: (K,) cosine of the smooth normal.
    """

    highlights: dict[str, Float64]
    mirror: dict[str, Float64]
    mirror_open: dict[str, Float64]
    kept: dict[str, Float64]
    kept_dull: Float64
    facing: Float64


class Shading:
    """The samples under a scene; ``picture`` returns them with some effects left out."""

    def __init__(self, scene: Scene, surface: SurfaceSamples, light: Illumination) -> None:
        """Shade by every light alone, ``illumination(scene)`` of a scene with a number for its exposure."""
        self.scene, self.surface = scene, surface
        s = surface
        self.directions = spread_directions(s.visible.shape[1])
        flux = flux_by_direction(light.sky, len(self.directions))
        lit = np.einsum("kd,dcx->kcx", s.visible, flux[:, :, None] * self.directions[:, None, :], optimize=True)
        # (S, K, 3) irradiance of the sky on the diffuse normals, with the head's occlusion and without.
        self.sky_blocked = np.maximum(np.einsum("kcx,skx->skc", lit, s.diffuse_normal), 0.0)
        self.sky_open = irradiance(project(light.sky), s.diffuse_normal)
        solid_angle = 4.0 * np.pi / len(self.directions)
        vector = solid_angle * (s.visible @ self.directions)
        self.openness = np.clip(np.einsum("kx,kx->k", vector, s.normal) / np.pi, 0.0, 1.0)
        self._lights = light.lights
        self.lamps = [Lamp.of(item, s, self.directions) for item in light.lights]
        self.views = [self._view(viewpoint, flux / solid_angle) for viewpoint in scene.viewpoints]
        weight = np.stack([np.maximum(v.facing, 0.02) ** 4 for v in self.views])
        self.view_weight = weight / weight.sum(0)

    def _view(self, viewpoint: Triple, radiance: Float64) -> SeenSamples:
        s = self.surface
        v = normalise(np.asarray(viewpoint) - s.position[0])
        f0 = F0_SCALE * np.clip(s.specular, 0.0, 1.0)
        lobes = {
            "both": ((s.alpha[:, 0], s.share), (s.alpha[:, 1], 1.0 - s.share)),
            "one": ((s.alpha[:, 1] + (s.alpha[:, 0] - s.alpha[:, 1]) * s.share, np.ones_like(s.share)),),
        }
        lobes["flat"] = lobes["both"]
        cosine = np.einsum("kx,kx->k", s.specular_normal[0], v)
        n_v = np.clip(cosine, 1e-3, 1.0)
        reflected = normalise(2.0 * cosine[:, None] * s.specular_normal[0] - v)
        mirror, opened, kept = {}, {}, {}
        for kind in KINDS:
            part, image, hidden = np.zeros(len(f0)), np.zeros((len(f0), 3)), np.zeros((len(f0), 3))
            for alpha, share in lobes[kind]:
                points = {"view": v, "normal": s.specular_normal[0], "specular": s.specular, "alpha": alpha}
                each = share * _computed(_graph("kept", kind), points)
                seen = each[:, None] * (mirror_weights(reflected, alpha, self.directions) @ radiance)
                part, image = part + each, image + seen
                hidden = hidden + seen * mirror_openness(self.openness, n_v, alpha)[:, None]
            mirror[kind], opened[kind], kept[kind] = hidden, image, 1.0 - np.clip(part, 0.0, 1.0)
        highlights = {kind: self._highlights(v, lobes[kind], kind) for kind in KINDS}
        return SeenSamples(highlights, mirror, opened, kept, 1.0 - f0, np.einsum("kx,kx->k", s.normal, v))

    def _highlights(self, v: Float64, lobes: tuple[tuple[Float64, Float64], ...], kind: str) -> Float64:
        """(lights, P, K, 3) radiance of highlights, without shadows."""
        s, places = self.surface, len(self.surface.specular_normal)

        def everywhere(values: Float64) -> Float64:
            return np.broadcast_to(values, (places, *values.shape))

        points = {
            "position": everywhere(1000.0 * s.position[0]), "view": everywhere(v), "normal": s.specular_normal,
            "shade": np.ones(s.specular_normal.shape[:2]), "specular": everywhere(s.specular),
        }  # fmt: skip
        result = []
        for light in self._lights:
            value = np.zeros_like(s.specular_normal)
            for alpha, share in lobes:
                lobe = points | {"alpha": everywhere(alpha)}
                value = value + share[:, None] * _computed(_graph("highlight", kind), lobe, **lamp_numbers(light))
            result.append(value)
        return np.stack(result) if result else np.zeros((0, *s.specular_normal.shape))

    def arriving(self, i: int, out: set[Item]) -> Float64:
        """(P, K) share of light i that arrives.

        With ``(DARK, i)`` or ``(BRIGHT, i)`` its shadows are the darkest or the lightest possible, with ``(LOW, i)``
        the relief's shadows are the darkest possible; with ``(GONE, i)`` the light is off.
        """
        lamp = self.lamps[i]
        if (GONE, i) in out:
            return np.zeros_like(lamp.relief)
        seen = lamp.least if (DARK, i) in out else lamp.most if (BRIGHT, i) in out else lamp.seen
        seen = np.ones_like(seen) if ("shadows", i) in out else seen
        if ("relief_shadows", i) in out:
            return np.broadcast_to(seen, lamp.relief.shape)
        return np.asarray(seen * (lamp.lowest if (LOW, i) in out else lamp.relief))

    def diffuse(self, out: set[Item]) -> Float64:
        """(K, 3) albedo times irradiance, scattered."""
        s = self.surface
        e = (self.sky_open if ("occlusion", None) in out else self.sky_blocked).copy()
        for i, lamp in enumerate(self.lamps):
            e += lamp.irradiance * self.arriving(i, out)[0, :, None]
        if ("scattering", None) in out:
            return np.asarray(s.albedo[0] * e[0])
        root = np.sqrt(s.albedo)
        x = root * e
        rings = x[1:].reshape(len(RINGS), 4, *x.shape[1:]).mean(1)
        blurred = x[0] * (1.0 - RINGS.sum(0)) + np.einsum("rkc,rc->kc", rings, RINGS)
        return np.asarray(root[0] * blurred)

    def picture(self, out: set[Item]) -> Float64:
        """(P, K, 3) coded sRGB with some effects left out.

        The places of a sample differ in their fine relief only: its highlights and its shadows.
        """
        total = np.zeros_like(self.surface.specular_normal)
        for weight, light in zip(self.view_weight, self.light(out), strict=True):
            total += weight[:, None] * develop(light, self.scene.response)
        return total

    def light(self, out: set[Item]) -> list[Float64]:
        """(P, K, 3) linear light towards each viewpoint, with some effects left out."""
        diffuse = self.diffuse(out)
        mirrors = ("reflection", None) not in out
        shine = [i for i in range(len(self.lamps)) if ("specular", i) not in out]
        arriving = [self.arriving(i, out) for i in range(len(self.lamps))]
        # Places other than the centre differ from it by their relief shadows.
        local = self._beside(arriving)
        kind = "one" if ("second_lobe", None) in out else "flat" if ("fresnel", None) in out else "both"
        result = []
        for view in self.views:
            kept = view.kept[kind] if shine or (mirrors and self.sky_open.any()) else view.kept_dull
            light = (diffuse + local) / np.pi * kept[:, None]
            for i in shine:
                light = light + view.highlights[kind][i] * arriving[i][..., None]
            if mirrors:
                light = light + (view.mirror_open if ("occlusion", None) in out else view.mirror)[kind]
            result.append(light)
        return result

    def luminance(self) -> Float64:
        """(K,) linear luminance of the samples, with white balance and all effects, before exposure."""
        balance = np.asarray(self.scene.response.white_balance) * LUMA
        return sum(
            (w * (light.mean(0) @ balance) for w, light in zip(self.view_weight, self.light(set()), strict=True)),
            np.zeros(len(self.surface.weight)),
        )

    def _beside(self, arriving: list[Float64]) -> Float64:
        """(P, K, 3) difference of each place's diffuse light to the centre's by relief shadows, not scattered."""
        s = self.surface
        total = np.zeros_like(s.specular_normal)
        for lamp, share in zip(self.lamps, arriving, strict=True):
            total += (share - share[:1])[..., None] * lamp.irradiance[0] * s.albedo[0]
        return total

    def soft_edges(self) -> Float64:
        """(K, 3) change by scattering at shadow edges, which the samples are too sparse to resolve."""
        full = self.diffuse(set()) / np.pi
        total = np.zeros_like(full)
        for lamp in self.lamps:
            edge = 0.25 * (lamp.most - lamp.least)[:, None] * lamp.irradiance[0] * self.surface.albedo[0] / np.pi
            up = develop(full + edge * (RINGS[1:].sum(0) + 0.2 * RINGS[0]), self.scene.response)
            total += up - develop(full, self.scene.response)
        return total
