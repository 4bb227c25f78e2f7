"""Choose the effects of light that a scene needs, and bound the error of leaving out the others.

The error of leaving out an effect is estimated on a few hundred points of the surface in the scene
(``service.light.estimate``). Effects are left out in the order of bound over time, as long as the sum of their bounds
stays within the tolerance. There are no special cases: under a frontal lamp, an overcast sky or on matt skin, effects
are left out because their estimates are small.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

from service.errors import UsageError
from service.light.environment import illumination
from service.light.estimate import Facts, estimate
from service.light.scene import Scene
from service.light.surface import SurfaceSamples

WHOLE = ("occlusion", "reflection", "second_lobe", "fresnel", "scattering")
PER_LIGHT = ("shadows", "relief_shadows", "specular")
EFFECTS = (*WHOLE, *PER_LIGHT)

_COST = {
    "occlusion": 3.0, "reflection": 4.0, "second_lobe": 1.0, "fresnel": 0.3, "scattering": 10.0, "shadows": 12.0,
    "relief_shadows": 3.0, "specular": 1.5,
}  # fmt: skip
"""Relative time of the effects (``python -m benchmarks.skipping``); decides only the order of leaving out."""


@dataclass(frozen=True)
class Decision:
    """Decision about one effect.

    Attributes:
        effect: one of ``EFFECTS``.
        light: index into ``illumination(scene).lights`` for effects of single lights, else None.
        runs: whether it is computed.
        bound: upper bound of the mean absolute error of the picture in 1/255 of sRGB if it is left out.
        why: the reason in words.
    """

    effect: str
    light: int | None
    runs: bool
    bound: float
    why: str


@dataclass(frozen=True)
class Plan:
    """Which effects run.

    Attributes:
        decisions: one for every effect (and light).
        tolerance: as requested, in 1/255 of sRGB.
    """

    decisions: tuple[Decision, ...]
    tolerance: float

    @property
    def bound(self) -> float:
        """Sum of the bounds of the effects left out, in 1/255 of sRGB (mean absolute error over the face)."""
        return sum(d.bound for d in self.decisions if not d.runs)

    @property
    def left_out(self) -> tuple[Decision, ...]:
        """Decisions against an effect."""
        return tuple(d for d in self.decisions if not d.runs)

    def runs(self, effect: str, light: int | None = None) -> bool:
        """Whether an effect is computed.

        Raises:
            KeyError: the plan knows no such effect or light (it was made for another scene).
        """
        for d in self.decisions:
            if d.effect == effect and d.light == light:
                return d.runs
        raise KeyError(f"the plan has no effect {effect!r} of light {light}")

    def without(self, effect: str, light: int | None = None) -> Plan:
        """The same plan with one effect left out."""
        changed = [
            dataclasses.replace(d, runs=False) if (d.effect, d.light) == (effect, light) else d for d in self.decisions
        ]
        return Plan(tuple(changed), self.tolerance)

    def to_json(self) -> str:
        """As JSON, for manifests and logs."""
        return json.dumps({**dataclasses.asdict(self), "bound": self.bound}, indent=2)

    @classmethod
    def everything(cls, scene: Scene) -> Plan:
        """All effects of all lights."""
        items = _items(len(illumination(scene).lights))
        return cls(tuple(Decision(effect, light, True, 0.0, "asked for") for effect, light in items), 0.0)


def _items(lights: int) -> list[tuple[str, int | None]]:
    return [*((effect, None) for effect in WHOLE), *((effect, i) for i in range(lights) for effect in PER_LIGHT)]


def plan(scene: Scene, surface: SurfaceSamples, tolerance: float = 1.0) -> Plan:
    """Choose the effects for a scene on a surface.

    Args:
        scene: with a number for its exposure.
        surface: samples of the surface, see ``service.light.survey``.
        tolerance: largest mean absolute error over the face of all omissions together, in 1/255 of sRGB; 0 leaves out
            only what changes nothing.

    Raises:
        UsageError: no exposure, or a negative tolerance.
    """
    if scene.response.exposure is None:
        raise UsageError(
            "scene: exposure is null; it has to be a number, on which the error of leaving out an effect depends"
        )
    if not tolerance >= 0.0:
        raise UsageError(f"tolerance is {tolerance!r}; it has to be 0 or more, in 1/255 of sRGB")
    estimates = estimate(scene, surface)
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
    left, facts = set(chosen), estimates.facts()
    decisions = [Decision(e, i, (e, i) not in left, bounds[e, i], _why(e, i, bounds[e, i], facts)) for e, i in items]
    return Plan(tuple(decisions), float(tolerance))


def _why(effect: str, light: int | None, bound: float, e: Facts) -> str:
    if light is None:
        facts = {
            "occlusion": f"the sky gives {e.sky_share:.0%} of the light, {1.0 - e.openness:.0%} of it hidden",
            "reflection": f"the sky's mirror image adds {e.reflected:.1%} to the light",
            "second_lobe": f"highlights of lamps are {e.highlights:.1%} of the light",
            "fresnel": f"lamps graze the surface as seen by the camera: half angle {e.half_angle_deg:.0f} degrees",
            "scattering": f"light changes by {e.contrast:.0%} within the range of scattering",
        }
        return f"{facts[effect]}: {bound:.2f}/255"
    facts = {
        "shadows": f"light {light} gives {e.light_share[light]:.0%} of the light, {e.hidden[light]:.0%} of it hidden",
        "relief_shadows": f"light {light} stands {e.elevation_deg[light]:.0f} degrees above the skin",
        "specular": f"highlights of light {light} are {e.light_highlights[light]:.1%} of the light",
    }
    return f"{facts[effect]}: {bound:.2f}/255"


def report(made: Plan) -> str:
    """Text for people: which effects run, which do not and why, and the error at most."""
    lines = []
    for d in sorted(made.decisions, key=lambda d: (d.runs, -d.bound)):
        name = d.effect if d.light is None else f"{d.effect} of light {d.light}"
        lines.append(f"{'runs    ' if d.runs else 'left out'} {name:28s} {d.why}")
    return "\n".join([*lines, f"error at most {made.bound:.2f}/255 of {made.tolerance:g}/255 allowed"])
