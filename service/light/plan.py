"""Choose the effects of light that a scene needs, and bound the error of leaving out the others.

The error of leaving out an effect is estimated on a few hundred points of the surface in the scene
(``service.light.plan``). Effects are left out in the order of bound over time, as long as the sum of their bounds
stays within the tolerance. There are no special cases: under a frontal lamp, an overcast sky or on matt skin, effects
are left out because their estimates are small.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from service.arrays import Float64
from service.errors import UsageError
from service.light.environment import illumination
from service.light.samples import SurfaceSamples
from service.light.scene import Scene
from service.light.shading import BRIGHT, DARK, GONE, LOW, Item, Shading

MARGIN = 1.4
"""Factor of the bound for the approximations of the shading."""
FLOOR = 0.01
"""Constant part of every bound, 1/255 of sRGB."""

_SHADOWS = ("shadows", "relief_shadows")
_ASSUMPTIONS: dict[str, tuple[tuple[str, ...], ...]] = {
    "shadows": ((DARK,),),
    "relief_shadows": ((LOW,), (LOW, BRIGHT)),
    "specular": ((), (BRIGHT,)),
}
"""Assumptions about a light under which the change is computed when an effect of it is left out; the worst counts.

In full shadow nothing of a lamp is left to lose, so highlights and relief shadows are also tried in the lightest.
"""


class Estimates:
    """Shaded samples, and the bounds computed from them."""

    def __init__(self, shading: Shading) -> None:
        """Take samples that are shaded by each light alone."""
        self.shading = shading
        self.light_count = len(shading.lamps)
        self._whole = shading.picture(set())

    def bound(self, effect: str, light: int | None) -> float:
        """Upper bound of the mean absolute error, 1/255 of sRGB, of leaving out an effect; 0 if it changes nothing."""
        if self._idle(effect, light):
            return 0.0
        worst = 0.0
        for assumptions in _ASSUMPTIONS.get(effect, ((),)):
            change = self._change([(effect, light)], {(name, light) for name in assumptions})
            mean, error = self._mean(change)
            rare = 255.0 * self._rare(effect, light, change)
            worst = max(worst, FLOOR + MARGIN * (mean + 2.0 * error) + rare)
        return worst

    def together(self, items: list[Item]) -> float:
        """Mean absolute error in 1/255 of sRGB of leaving out several effects at once, without margins."""
        active = [item for item in items if not self._idle(*item)]
        assumptions: set[Item] = {(_ASSUMPTIONS[e][0][0], i) for e, i in active if e in _SHADOWS}
        return self._mean(self._change(active, assumptions))[0] if active else 0.0

    def _idle(self, effect: str, light: int | None) -> bool:
        """Whether no sample receives the light that an effect is about."""
        s = self.shading
        if light is not None:
            return not s.lamps[light].facing_irradiance.any()
        if effect in ("occlusion", "reflection"):
            return not (s.sky_open.any() or s.sky_blocked.any())
        return not (s.sky_open.any() or any(lamp.facing_irradiance.any() for lamp in s.lamps))

    def _change(self, items: list[Item], assumptions: set[Item]) -> Float64:
        """(P, K) absolute change by leaving out effects, under assumptions about lights."""
        before = self.shading.picture(assumptions) if assumptions else self._whole
        change = np.abs(self.shading.picture({*items, *assumptions}) - before)
        if ("scattering", None) in items:
            # Relative error of the change by scattering: three rings miss features narrower than their spacing.
            change = (1.0 + 0.2) * change + self.shading.soft_edges()
        if ("second_lobe", None) in items:
            mirror = np.abs(self.shading.picture({("reflection", None)}) - self._whole)
            # Relative difference of the sky's reflection between one lobe and two, which the few directions cannot
            # resolve.
            change = change + 0.04 * mirror
        return np.asarray(change.mean(-1))

    def _rare(self, effect: str, light: int | None, change: Float64) -> float:
        """Contribution of one more sample with the largest error possible (Laplace's rule of succession)."""
        places, samples = change.shape
        if effect not in _SHADOWS:
            return float(change.mean(0).max() / samples)
        gone = np.abs(self.shading.picture({(GONE, light)}) - self._whole).mean((0, 2))
        points = samples * (places if effect == "relief_shadows" else 1)
        return float((self.shading.surface.weight @ gone) / points)

    def _mean(self, change: Float64) -> tuple[float, float]:
        """Mean and standard error in 1/255; the places of a sample are not independent and count as one."""
        w, each = self.shading.surface.weight, change.mean(0)
        mean = float(w @ each)
        error = float(np.sqrt(np.maximum(w @ (each - mean) ** 2, 0.0) * float(w @ w)))
        return 255.0 * mean, 255.0 * error


WHOLE = ("occlusion", "reflection", "second_lobe", "fresnel", "scattering")
PER_LIGHT = ("shadows", "relief_shadows", "specular")
EFFECTS = (*WHOLE, *PER_LIGHT)

_COST = {
    "occlusion": 3.0, "reflection": 4.0, "second_lobe": 1.0, "fresnel": 0.3, "scattering": 10.0, "shadows": 12.0,
    "relief_shadows": 3.0, "specular": 1.5,
}  # fmt: skip
"""Relative time of the effects (``models.lightstage.light.skipping``); decides only the order of leaving out."""


@dataclass(frozen=True)
class Decision:
    """Decision about one effect.

    Attributes:
        effect: one of ``EFFECTS``.
        light: index into ``illumination(scene).lights`` for effects of single lights, else None.
        runs: whether it is computed.
        bound: upper bound of the mean absolute error of the picture in 1/255 of sRGB if it is left out.
    """

    effect: str
    light: int | None
    runs: bool
    bound: float


@dataclass(frozen=True)
class LightPlan:
    """Which effects run: one decision for every effect (and light), within a tolerance in 1/255 of sRGB."""

    decisions: tuple[Decision, ...]
    tolerance: float

    @property
    def bound(self) -> float:
        """Sum of the bounds of the effects left out, in 1/255 of sRGB (mean absolute error over the face)."""
        return sum(d.bound for d in self.decisions if not d.runs)

    def runs(self, effect: str, light: int | None = None) -> bool:
        """Whether an effect is computed; KeyError: the plan, made for another scene, knows no such effect or light."""
        for d in self.decisions:
            if d.effect == effect and d.light == light:
                return d.runs
        raise KeyError(f"the plan has no effect {effect!r} of light {light}")

    def without(self, effect: str, light: int | None = None) -> LightPlan:
        """The same plan with one effect left out."""
        changed = [
            dataclasses.replace(d, runs=False) if (d.effect, d.light) == (effect, light) else d for d in self.decisions
        ]
        return LightPlan(tuple(changed), self.tolerance)

    @classmethod
    def everything(cls, scene: Scene) -> LightPlan:
        """All effects of all lights."""
        items = _items(len(illumination(scene).lights))
        return cls(tuple(Decision(effect, light, True, 0.0) for effect, light in items), 0.0)


def _items(lights: int) -> list[tuple[str, int | None]]:
    return [*((effect, None) for effect in WHOLE), *((effect, i) for i in range(lights) for effect in PER_LIGHT)]


def plan(scene: Scene, surface: SurfaceSamples, tolerance: float = 1.0) -> LightPlan:
    """Choose the effects for a scene on samples of a surface (``service.light.samples``).

    ``tolerance`` is the largest mean absolute error over the face of all omissions together, in 1/255 of sRGB; 0 leaves
    out only what changes nothing. UsageError: no exposure, or a negative tolerance.
    """
    if scene.response.exposure is None:
        raise UsageError(
            "scene: exposure is null; it has to be a number, on which the error of leaving out an effect depends"
        )
    if not tolerance >= 0.0:
        raise UsageError(f"tolerance is {tolerance!r}; it has to be 0 or more, in 1/255 of sRGB")
    estimates = Estimates(Shading(scene, surface, illumination(scene)))
    items = _items(estimates.light_count)
    bounds = {item: estimates.bound(*item) for item in items}
    chosen: list[tuple[str, int | None]] = []
    spent = 0.0
    for item in sorted(items, key=lambda item: bounds[item] / _COST[item[0]]):
        if spent + bounds[item] > tolerance:
            continue
        if estimates.together([*chosen, item]) > spent + bounds[item] + 1e-9:
            continue  # the error of leaving out both exceeds the sum of the bounds
        chosen.append(item)
        spent += bounds[item]
    decisions = [Decision(*item, item not in chosen, bounds[item]) for item in items]
    return LightPlan(tuple(decisions), float(tolerance))


def report(made: LightPlan) -> str:
    """Text for people: which effects run, and what leaving each of them out costs at most."""
    lines = []
    for d in sorted(made.decisions, key=lambda d: (d.runs, -d.bound)):
        name = d.effect if d.light is None else f"{d.effect} of light {d.light}"
        lines.append(f"{'runs    ' if d.runs else 'left out'} {name:28s} {d.bound:.2f}/255 without it")
    return "\n".join([*lines, f"error at most {made.bound:.2f}/255 of {made.tolerance:g}/255 allowed"])
