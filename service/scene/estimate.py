"""What each effect of light is worth on a surface: the sample points shaded with and without it.

The shading is that of ``models/lightstage/light`` in short; a test holds the two together. A bound is the mean change
over the samples plus two standard errors, times a factor for what a few hundred points and a few directions cannot see.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from service.scene.environment import illumination
from service.scene.harmonics import irradiance, project
from service.scene.scene import PointLight, Response, Scene
from service.scene.sphere import flux_by_direction, spread_directions
from service.scene.surface import AZIMUTHS, Surface

Array = npt.NDArray[np.float64]
Item = tuple[str, int | None]

MARGIN = 1.4
FLOOR = 0.01
MIRROR_DOUBT = 0.04
"""Share of the sky's mirror image by which two lobes and one may differ: directions are too few to tell them apart."""
_F0 = 0.04
_WIDE = np.array([0.55, 0.02, 0.01])
_NARROW = np.array([0.22, 0.53, 0.34])
"""Share of each colour's profile that the outer and the inner ring stand for."""


def develop(light: Array, response: Response) -> Array:
    """(..., 3) coded sRGB in [0, 1] of linear light, as the camera's response says."""
    x = np.maximum(light * np.asarray(response.white_balance) * float(response.exposure or 0.0), 0.0)
    if response.shoulder > 0.0:
        knee = 1.0 - response.shoulder
        bent = knee + response.shoulder * -np.expm1(-np.maximum(x - knee, 0.0) / response.shoulder)
        x = np.where(x > knee, bent, x)
    x = np.minimum(x, 1.0)
    coded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.asarray(np.maximum(coded, 0.0) ** response.gamma)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _lobe(alpha: Array, n_h: Array, n_l: Array, n_v: Array) -> Array:
    a2 = alpha * alpha
    d = (1.0 - n_h * n_h) + a2 * n_h * n_h
    reach = (n_l + np.sqrt(a2 + (1 - a2) * n_l * n_l)) * (n_v + np.sqrt(a2 + (1 - a2) * n_v * n_v))
    return np.asarray(a2 / (np.pi * d * d * np.maximum(reach, 1e-4)))


@dataclass
class _Lamp:
    """One light on the samples: diffuse irradiance (S, K, 3), visibility, and highlights by view."""

    irradiance: Array
    irradiance_at: Array
    seen: Array
    least: Array
    most: Array
    towards: Array
    relief: Array
    n_l: Array


@dataclass
class Estimates:
    """Shaded samples; ask for ``bound``.

    The numbers that end in a plan's reasons are means over the samples.
    """

    scene: Scene
    surface: Surface
    light_count: int
    lamps: list[_Lamp] = field(default_factory=list)
    sky_share: float = 0.0
    openness: float = 1.0
    reflected: float = 0.0
    highlights: float = 0.0
    half_angle_deg: float = 0.0
    contrast: float = 0.0
    light_share: list[float] = field(default_factory=list)
    hidden: list[float] = field(default_factory=list)
    elevation_deg: list[float] = field(default_factory=list)
    light_highlights: list[float] = field(default_factory=list)

    def prepare(self, lights: tuple[PointLight, ...], sky: Array) -> None:
        """Shade the samples by every light alone."""
        s = self.surface
        self.directions = spread_directions(s.visible.shape[1])
        flux = flux_by_direction(sky, len(self.directions))
        above = s.visible * (s.normal @ self.directions.T > 0.0)
        vector = np.einsum("kd,dc,dx->kcx", above, flux, self.directions)
        self.sky_blocked = np.maximum(np.einsum("kcx,skx->skc", vector, s.diffuse_normal), 0.0)
        self.sky_open = irradiance(project(sky), s.diffuse_normal)
        self.lamps = [self._lamp(light) for light in lights]
        self.views = [self._view(np.asarray(v), flux) for v in self.scene.viewpoints]
        weight = np.stack([np.maximum((v["geometric"]), 0.02) ** 4 for v in self.views])
        self.view_weight = weight / weight.sum(0)
        self._facts(sky)

    def _lamp(self, light: PointLight) -> _Lamp:
        s = self.surface
        offset = np.asarray(light.position_m) - s.position
        distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)
        towards = offset / distance[..., None]
        fall = 1.0 / np.maximum(distance**2, max(light.radius_m**2, 1e-6))
        size = np.clip(light.radius_m / distance, 1e-6, 1.0)
        n_l = np.einsum("skx,skx->sk", towards, s.diffuse_normal)
        soft = np.where(np.abs(n_l) < size, (n_l + size) ** 2 / (4 * size), np.maximum(n_l, 0.0))
        light_at = fall[..., None] * np.asarray(light.intensity)
        cosine = towards[0] @ self.directions.T
        reach = np.cos(np.minimum(np.radians(9.0) + size[0], 1.5))[:, None]
        near = (cosine > reach) & (s.normal @ self.directions.T > 0.04)
        any_near = near.any(1)
        best = np.take_along_axis(s.visible, cosine.argmax(1)[:, None], 1)[:, 0]
        least = np.where(any_near, np.where(near, s.visible, 1.0).min(1), best)
        most = np.where(any_near, np.where(near, s.visible, 0.0).max(1), best)
        count = np.maximum(near.sum(1), 1)
        seen = np.where(any_near, (s.visible * near).sum(1) / count, best)
        return _Lamp(
            light_at * soft[..., None], light_at[0], seen, least, most, towards[0], self._relief(towards[0]), n_l[0]
        )

    def _relief(self, towards: Array) -> Array:
        s = self.surface
        x, y, z = (np.einsum("kx,kx->k", towards, axis) for axis in (s.tangent, s.bitangent, s.normal))
        step = np.rint(np.arctan2(y, x) / (2 * np.pi) * AZIMUTHS).astype(int) % AZIMUTHS
        horizon = s.horizon[np.arange(len(step)), step]
        slope = z / np.maximum(np.hypot(x, y), 1e-4)
        return np.asarray(np.clip((slope - horizon) / 0.08 + 1.0, 0.0, 1.0))

    def _view(self, at: Array, flux: Array) -> dict[str, Array]:
        """Highlights (lights, K, 3) of three kinds and the sky's mirror image (K, 3) for one viewpoint."""
        s = self.surface
        v = _unit(at - s.position[0])
        n = s.specular_normal
        n_v = np.clip(np.einsum("kx,kx->k", n, v), 1e-3, 1.0)
        f0 = _F0 * s.specular
        kinds: dict[str, list[Array]] = {"both": [], "one": [], "flat": []}
        half = []
        for lamp in self.lamps:
            h = _unit(lamp.towards + v)
            n_h = np.clip(np.einsum("kx,kx->k", n, h), 0.0, 1.0)
            v_h = np.clip(np.einsum("kx,kx->k", v, h), 0.0, 1.0)
            n_l = np.clip(np.einsum("kx,kx->k", n, lamp.towards), 0.0, 1.0)
            lobes = [_lobe(s.alpha[:, i], n_h, n_l, n_v) for i in (0, 1)]
            both = s.share * lobes[0] + (1 - s.share) * lobes[1]
            one = _lobe(s.share * s.alpha[:, 0] + (1 - s.share) * s.alpha[:, 1], n_h, n_l, n_v)
            rise = f0 + (1 - f0) * (1 - v_h) ** 5
            for name, value in (("both", both * rise), ("one", one * rise), ("flat", both * f0)):
                kinds[name].append((value * n_l)[:, None] * lamp.irradiance_at)
            half.append(float(np.degrees(np.arccos(v_h)).mean()))
        self.half_angle_deg = max(half, default=0.0)
        mirror, mirror_flat, mirror_one = self._mirror(v, n, n_v, f0, flux)
        empty = np.zeros((0, len(f0), 3))
        spread = {name: np.stack(each) if each else empty for name, each in kinds.items()}
        lost = np.minimum(f0 + (1 - f0) * (1 - n_v) ** 5 * 0.6, 1.0)
        geometric = np.einsum("kx,kx->k", s.normal, v)
        mirrors = {"mirror_both": mirror, "mirror_flat": mirror_flat, "mirror_one": mirror_one}
        return {**spread, **mirrors, "geometric": geometric, "lost": lost, "f0": f0}

    def _mirror(self, v: Array, n: Array, n_v: Array, f0: Array, flux: Array) -> tuple[Array, Array, Array]:
        s = self.surface
        d = self.directions[None]
        h = _unit(d + v[:, None])
        n_h = np.clip(np.einsum("kx,kdx->kd", n, h), 0.0, 1.0)
        v_h = np.clip(np.einsum("kx,kdx->kd", v, h), 0.0, 1.0)
        n_l = np.clip(n @ self.directions.T, 0.0, 1.0)
        seen = n_l * s.visible
        first, second = (_lobe(s.alpha[:, i : i + 1], n_h, n_l, n_v[:, None]) for i in (0, 1))
        both = (s.share[:, None] * first + (1 - s.share[:, None]) * second) * seen
        mean = s.share * s.alpha[:, 0] + (1 - s.share) * s.alpha[:, 1]
        one = _lobe(mean[:, None], n_h, n_l, n_v[:, None]) * seen
        rise = f0[:, None] + (1 - f0[:, None]) * (1 - v_h) ** 5
        return (both * rise) @ flux, (both * f0[:, None]) @ flux, (one * rise) @ flux

    def _facts(self, sky: Array) -> None:
        s = self.surface
        share = [float((s.weight @ (lamp.irradiance[0] * lamp.seen[:, None])).mean()) for lamp in self.lamps]
        sky_mean = float((s.weight @ self.sky_blocked[0]).mean())
        total = max(sum(share) + sky_mean, 1e-30)
        self.sky_share = sky_mean / total
        self.openness = sky_mean / max(float((s.weight @ self.sky_open[0]).mean()), 1e-30) if sky.any() else 1.0
        self.light_share = [x / total for x in share]
        self.hidden = [float(s.weight @ (1.0 - lamp.least)) for lamp in self.lamps]
        self.elevation_deg = [
            float(np.degrees(np.arcsin(np.clip(s.weight @ np.maximum(lamp.n_l, 0.0), 0, 1)))) for lamp in self.lamps
        ]
        diffuse = max(float((s.weight @ (self._diffuse(set()) / np.pi)).mean()), 1e-30)
        marks = [float((s.weight @ self.views[0]["both"][i]).mean()) for i in range(len(self.lamps))]
        self.light_highlights = [m / diffuse for m in marks]
        self.highlights = sum(marks) / diffuse
        self.reflected = float((s.weight @ self.views[0]["mirror_both"]).mean()) / diffuse
        steady, local = self._diffuse(set()), self._diffuse({("scattering", None)})
        self.contrast = float((s.weight @ np.abs(steady - local)).mean()) / (np.pi * diffuse)

    def _seen(self, i: int, out: set[Item]) -> Array:
        """(K,) share of light i that arrives."""
        lamp = self.lamps[i]
        seen = np.ones_like(lamp.seen) if ("shadows", i) in out else lamp.least if ("_dark", i) in out else lamp.seen
        return seen if ("relief_shadows", i) in out else seen * lamp.relief

    def _diffuse(self, out: set[Item]) -> Array:
        """(K, 3) albedo times irradiance, scattered."""
        s = self.surface
        e = (self.sky_open if ("occlusion", None) in out else self.sky_blocked).copy()
        for i, lamp in enumerate(self.lamps):
            e += lamp.irradiance * self._seen(i, out)[None, :, None]
        if ("scattering", None) in out:
            return np.asarray(s.albedo[0] * e[0])
        root = np.sqrt(s.albedo)
        x = root * e
        blurred = x[0] * (1 - _WIDE - _NARROW) + x[1:5].mean(0) * _NARROW + x[5:].mean(0) * _WIDE
        return np.asarray(root[0] * blurred)

    def picture(self, out: set[Item]) -> Array:
        """(K, 3) coded sRGB of the samples with some effects left out."""
        diffuse = self._diffuse(out) / np.pi
        total = np.zeros_like(diffuse)
        mirror_runs = ("reflection", None) not in out
        shine = [i for i in range(len(self.lamps)) if ("specular", i) not in out]
        for k, view in enumerate(self.views):
            kind = "one" if ("second_lobe", None) in out else "flat" if ("fresnel", None) in out else "both"
            light = diffuse * (1.0 - view["lost" if shine or mirror_runs else "f0"])[:, None]
            for i in shine:
                light = light + view[kind][i] * self._seen(i, out)[:, None]
            if mirror_runs:
                light = light + view[f"mirror_{kind}"]
            total += self.view_weight[k][:, None] * develop(light, self.scene.response)
        return total

    def bound(self, effect: str, light: int | None) -> float:
        """Mean absolute error in 1/255 if one effect is left out, at most; 0 where it cannot matter."""
        if self._idle(effect, light):
            return 0.0
        return self._margin(self._change([(effect, light)]))

    def together(self, items: list[Item]) -> float:
        """As ``bound`` for several effects left out at once, without the margin."""
        active = [item for item in items if not self._idle(*item)]
        return self._mean(self._change(active))[0] if active else 0.0

    def _idle(self, effect: str, light: int | None) -> bool:
        if light is not None:
            return not self.lamps[light].irradiance_at.any()
        if effect in ("occlusion", "reflection"):
            return not (self.sky_open.any() or self.sky_blocked.any())
        return not (self.sky_open.any() or any(lamp.irradiance_at.any() for lamp in self.lamps))

    def _change(self, items: list[Item]) -> Array:
        """(K,) absolute change, the worse of two guesses about where shadows lie."""
        out = set(items)
        dark: set[Item] = {("_dark", i) for e, i in items if e == "shadows"}
        change = np.abs(self.picture(out) - self.picture(dark))
        if ("scattering", None) in out:
            change = change + self._edges()
        if ("second_lobe", None) in out:
            mirror = np.abs(self.picture({("reflection", None)}) - self.picture(set()))
            change = change + MIRROR_DOUBT * mirror
        return np.asarray(change.mean(1))

    def _edges(self) -> Array:
        """(K, 3) what scattering does to shadow edges that the samples are too coarse to see."""
        full = self._diffuse(set()) / np.pi
        total = np.zeros_like(full)
        for lamp in self.lamps:
            edge = 0.25 * (lamp.most - lamp.least)[:, None] * lamp.irradiance[0] * self.surface.albedo[0] / np.pi
            up = develop(full + edge * (_WIDE + 0.2 * _NARROW), self.scene.response)
            total += up - develop(full, self.scene.response)
        return total

    def _mean(self, change: Array) -> tuple[float, float]:
        w = self.surface.weight
        mean = float(w @ change)
        error = float(np.sqrt(np.maximum(w @ (change - mean) ** 2, 0.0) * float(w @ w)))
        return 255.0 * mean, 255.0 * error

    def _margin(self, change: Array) -> float:
        mean, error = self._mean(change)
        return FLOOR + MARGIN * (mean + 2.0 * error)


def estimate(scene: Scene, surface: Surface) -> Estimates:
    """Shade the samples; some milliseconds."""
    light = illumination(scene)
    made = Estimates(scene, surface, len(light.lights))
    made.prepare(light.lights, light.sky)
    return made
