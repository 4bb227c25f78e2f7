"""Shading: diffuse light on the chart, where it scatters, and specular light at the points that are seen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from service.arrays import Float32
from service.geometry.chart import unit_vectors
from service.light.environment import Illumination, prefiltered
from service.light.formulas import F0_SCALE, Graphs, irradiance, lamp_numbers, project, with_flesh
from service.light.plan import LightPlan
from service.light.scene import PointLight, Triple
from service.render.draw import SeenHead
from service.render.surface import Surface
from service.render.visibility import Visibility

SCATTER_MM = 8.2
"""Three standard deviations of the widest Gaussian of the diffusion profile (red, variance 7.41 mm^2)."""

TILE = 512
"""Side of the tiles on which scattering is computed, texels."""
ALIGNED = 64
"""Texels to whose multiples tiles are aligned, as wide blurs are computed on reduced maps."""


class Clock:
    """Seconds by step."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Add the time of a block to ``name``."""
        import time

        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


@dataclass(frozen=True)
class HeadShader:
    """Shades one surface by one scene's light; ``plan`` says which effects are computed."""

    surface: Surface
    visibility: Visibility
    light: Illumination
    plan: LightPlan
    graphs: Graphs
    clock: Clock

    def radiance(self, seen: SeenHead, viewpoint: Triple) -> Float32:
        """(N, 3) linear radiance >= 0 of the points on the head towards a viewpoint."""
        shades = [self._shade(item, i) for i, item in enumerate(self.light.lights)]
        diffuse = seen.read(self._diffuse(shades, seen))
        with self.clock.step("gloss"):
            return self._glossy(seen, viewpoint, diffuse, shades)

    def _shade(self, light: PointLight, index: int) -> Float32:
        """(H, W) visible share of a lamp in [0, 1]."""
        height, width = self.surface.specular.shape
        if not self.plan.runs("shadows", index):
            return np.ones((height, width), np.float32)
        with self.clock.step("shadows"):
            return self.visibility.shadow(light, (width, height))

    def _diffuse(self, shades: list[Float32], seen: SeenHead) -> Float32:
        """(H, W, 3) diffuse radiance after scattering, before specular reflection is subtracted."""
        s = self.surface
        with self.clock.step("diffuse"):
            arriving = self._sky()
            if shades:
                position, normal = _planes(s.position_m) * np.float32(1000), _planes(s.diffuse_normal)
            for light, shade in zip(self.light.lights, shades, strict=True):
                points = {"position": position, "normal": normal, "shade": shade}
                flat = {key: value.reshape(*value.shape[:-2], -1) for key, value in points.items()}
                lit = self.graphs.at_points("irradiance", flat, **lamp_numbers(light))
                arriving = arriving + lit.reshape(position.shape)
        albedo = _planes(np.clip(s.albedo, 0.0, 1.0))
        if self.plan.runs("occlusion"):
            arriving = self._with_flesh(albedo, arriving)
        radiosity = albedo * arriving
        if self.plan.runs("scattering"):
            with self.clock.step("scattering"):
                radiosity = self._scattered(albedo, arriving, seen)
        return np.ascontiguousarray(np.moveaxis(self._padded(radiosity) / np.float32(math.pi), 0, 2))

    def _with_flesh(self, albedo: Float32, arriving: Float32) -> Float32:
        """(3, H, W) irradiance with what skin sends from where no sky is seen: cheeks and palate light each other."""
        openness, skin = self.visibility.openness(self.surface.normal), self.surface.skin
        sent = (albedo * arriving * openness)[:, skin].sum(1) / max(float(openness[skin].sum()), 1e-6)
        return with_flesh(arriving, openness, albedo, sent[:, None, None])[0]

    def _scattered(self, albedo: Float32, arriving: Float32, seen: SeenHead) -> Float32:
        """(3, H, W) radiosity, scattered on the skin that is seen; elsewhere albedo times irradiance.

        Computed in tiles with padding as wide as the profile, as the blurs of a whole chart would need gigabytes.
        """
        s, radiosity = self.surface, albedo * arriving
        padding = int(np.ceil(SCATTER_MM * float(s.texels_per_mm.max()) / ALIGNED)) * ALIGNED
        height, width = s.skin.shape
        for top, left in _seen_tiles(seen, height, width):
            inner = (slice(top, min(top + TILE, height)), slice(left, min(left + TILE, width)))
            outer = (_grown(inner[0], padding, height), _grown(inner[1], padding, width))
            if not s.skin[inner].any():
                continue
            here = (slice(None), *outer)
            made = self.graphs.run(
                "scattering", albedo=albedo[here], arriving=arriving[here], texels_per_mm=s.texels_per_mm[outer],
                mask=s.skin[outer].astype(np.float32),
            )  # fmt: skip
            rows, columns = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
            there = (slice(None), *inner)
            radiosity[there] = np.where(s.skin[inner][None], made[:, rows, columns], radiosity[there])
        return np.asarray(radiosity)

    def _padded(self, planes: Float32) -> Float32:
        """(C, H, W) planes filled outside the islands."""
        return np.moveaxis(self.surface.chart.fill_outside(np.moveaxis(planes, 0, 2)), 2, 0)

    def _sky(self) -> Float32:
        """(3, H, W) irradiance of the environment."""
        s = self.surface
        height, width = s.specular.shape
        if self.light.dark:
            return np.zeros((3, height, width), np.float32)
        if not self.plan.runs("occlusion"):
            return _planes(irradiance(project(self.light.sky), s.diffuse_normal).astype(np.float32))
        vector = self.visibility.sky_light(self.light.sky, (width, height))
        return _planes(np.maximum(np.einsum("hwci,hwi->hwc", vector, s.diffuse_normal), 0.0))

    def _glossy(self, seen: SeenHead, viewpoint: Triple, diffuse: Float32, shades: list[Float32]) -> Float32:
        """(N, 3) radiance: ``diffuse`` less the specular albedo, highlights, and the reflection of the sky."""
        s, plan = self.surface, self.plan
        specular, alphas, share = seen.read(s.specular)[:, 0], seen.read(s.alpha), seen.read(s.share)[:, 0]
        mirrors = plan.runs("reflection") and not self.light.dark
        shining = [i for i in range(len(shades)) if plan.runs("specular", i)]
        if not (mirrors or shining):
            return diffuse * (1.0 - np.float32(F0_SCALE) * specular)[:, None]
        offset = np.asarray(viewpoint, np.float32) - seen.position_m
        view, normal = (unit_vectors(v).T for v in (offset, seen.read(s.specular_normal)))
        flat = "" if plan.runs("fresnel") else "_flat"
        ones = np.ones_like(share)
        lobes = [(alphas[:, 0], share), (alphas[:, 1], 1.0 - share)]
        if not plan.runs("second_lobe"):
            lobes = [(alphas[:, 1] + (alphas[:, 0] - alphas[:, 1]) * share, ones)]
        openness = ones
        if mirrors and plan.runs("occlusion"):
            openness = seen.read(self.visibility.openness(s.normal))[:, 0]
        total, taken = np.zeros((3, len(ones)), np.float32), np.zeros_like(ones)
        levels = prefiltered(self.light.sky) if mirrors else None
        for alpha, weight in lobes:
            common = {"view": view, "normal": normal, "specular": specular, "alpha": alpha}
            part = weight * self.graphs.at_points(f"kept{flat}", common)
            taken += part
            for i in shining:
                points = {
                    "position": seen.position_m.T * np.float32(1000), "shade": seen.read(shades[i])[:, 0],
                } | common  # fmt: skip
                shine = self.graphs.at_points(f"highlight{flat}", points, **lamp_numbers(self.light.lights[i]))
                total += weight * shine
            if levels is not None:
                points = {"view": view, "normal": normal, "part": part, "alpha": alpha, "openness": openness}
                total += self.graphs.at_points("reflection", points, levels=levels)
        return diffuse * (1.0 - np.clip(taken, 0.0, 1.0))[:, None] + total.T


def _seen_tiles(seen: SeenHead, height: int, width: int) -> list[tuple[int, int]]:
    """Top left corners of the tiles of the texels that are seen."""
    tiles = set()
    for down in (-1.5, 1.5):
        for right in (-1.5, 1.5):
            row = np.clip((1 - seen.uv[:, 1]) * height + down, 0, height - 1).astype(np.int64) // TILE
            column = np.clip(seen.uv[:, 0] * width + right, 0, width - 1).astype(np.int64) // TILE
            tiles |= set(np.unique((row << 16) | column).tolist())
    return [((tile >> 16) * TILE, (tile & 0xFFFF) * TILE) for tile in sorted(tiles)]


def _grown(part: slice, padding: int, size: int) -> slice:
    return slice(max(part.start - padding, 0), min(part.stop + padding, size))


def _planes(image: Float32) -> Float32:
    """(C, H, W) of (H, W, C)."""
    return np.ascontiguousarray(np.moveaxis(image, 2, 0), np.float32)
