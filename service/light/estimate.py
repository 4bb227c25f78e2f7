"""What each effect of light is worth on a surface, as a bound of the mean absolute error of leaving it out.

A bound has to hold for the whole surface although only some hundred points of it were shaded. It is
``FLOOR + MARGIN * (mean + 2 standard errors) + rare``:

- The mean is over the samples, each at several places of its fine relief; where the shading only guesses (shadows
  between the directions that visibility is known for, horizons between azimuths) the worse of two guesses counts.
- The standard error says how well the mean is known, if the samples show what there is to see.
- ``rare`` is for what they do not show: a shadow or a sparkle on less than one point in K may miss them all, and then
  mean and standard error are both 0. Laplace's rule of succession: as if one more sample had been drawn, as bad as any
  can be. For shadows that is a point without the lamp; for anything else the worst point seen.
- ``MARGIN`` is for what the short shading leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float64
from service.light.environment import illumination
from service.light.scene import Scene
from service.light.shading import BRIGHT, DARK, GONE, LOW, Item, Shading, develop
from service.light.surface import Surface

__all__ = ["Estimates", "Facts", "develop", "estimate"]

MARGIN = 1.4
FLOOR = 0.01
MIRROR_DOUBT = 0.04
"""Share of the sky's mirror image by which two lobes and one may differ: directions are too few to tell them apart."""

PROFILE_DOUBT = 0.2
"""Share of scattering's change that three rings may miss of a profile, in bands narrower than the rings."""

_SHADOWS = ("shadows", "relief_shadows")
_DOUBTS: dict[str, tuple[tuple[str, ...], ...]] = {
    "shadows": ((DARK,),),
    "relief_shadows": ((LOW,), (LOW, BRIGHT)),
    "specular": ((), (BRIGHT,)),
}
"""Guesses about a light for which the change is computed when an effect of that light is left out; the worst counts.

What a shadow hides leaves nothing to lose, so highlights and the relief's shadows are also tried in the least shadow.
"""


@dataclass(frozen=True)
class Facts:
    """What the reasons of a plan are made of: shares of the light, means over the samples; lists by light."""

    sky_share: float
    openness: float
    reflected: float
    highlights: float
    half_angle_deg: float
    contrast: float
    light_share: list[float]
    hidden: list[float]
    elevation_deg: list[float]
    light_highlights: list[float]


class Estimates:
    """Shaded samples; ask for ``bound``."""

    def __init__(self, shading: Shading) -> None:
        """From samples shaded by each light alone."""
        self.shading = shading
        self.light_count = len(shading.lamps)
        self._whole = shading.picture(set())

    def bound(self, effect: str, light: int | None) -> float:
        """Mean absolute error in 1/255 if one effect is left out, at most; 0 where it cannot matter."""
        if self._idle(effect, light):
            return 0.0
        worst = 0.0
        for doubts in _DOUBTS.get(effect, ((),)):
            change = self._change([(effect, light)], {(doubt, light) for doubt in doubts})
            mean, error = self._mean(change)
            rare = 255.0 * self._rare(effect, light, change)
            worst = max(worst, FLOOR + MARGIN * (mean + 2.0 * error) + rare)
        return worst

    def together(self, items: list[Item]) -> float:
        """Mean absolute error in 1/255 of leaving out several effects at once, without any doubt added."""
        active = [item for item in items if not self._idle(*item)]
        doubts: set[Item] = {(_DOUBTS[e][0][0], i) for e, i in active if e in _SHADOWS}
        return self._mean(self._change(active, doubts))[0] if active else 0.0

    def _idle(self, effect: str, light: int | None) -> bool:
        s = self.shading
        if light is not None:
            return not s.lamps[light].facing_it.any()
        if effect in ("occlusion", "reflection"):
            return not (s.sky_open.any() or s.sky_blocked.any())
        return not (s.sky_open.any() or any(lamp.facing_it.any() for lamp in s.lamps))

    def _change(self, items: list[Item], doubts: set[Item]) -> Float64:
        """(P, K) absolute change by leaving out effects, under guesses about lights."""
        before = self.shading.picture(doubts) if doubts else self._whole
        change = np.abs(self.shading.picture({*items, *doubts}) - before)
        if ("scattering", None) in items:
            change = (1.0 + PROFILE_DOUBT) * change + self.shading.soft_edges()
        if ("second_lobe", None) in items:
            mirror = np.abs(self.shading.picture({("reflection", None)}) - self._whole)
            change = change + MIRROR_DOUBT * mirror
        return np.asarray(change.mean(-1))

    def _rare(self, effect: str, light: int | None, change: Float64) -> float:
        """What one more point could add, as bad as any can be."""
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

    def facts(self) -> Facts:
        """Numbers for people."""
        s, w = self.shading, self.shading.surface.weight
        share = [float((w @ (lamp.irradiance[0] * lamp.seen[:, None])).mean()) for lamp in s.lamps]
        sky, open_sky = (float((w @ e[0]).mean()) for e in (s.sky_blocked, s.sky_open))
        total = max(sum(share) + sky, 1e-30)
        steady, local = s.diffuse(set()), s.diffuse({("scattering", None)})
        diffuse = max(float((w @ steady).mean()) / np.pi, 1e-30)
        marks = [float((w @ each.mean(0)).mean()) / diffuse for each in s.views[0].highlights["both"]]
        rise = [float(np.clip(w @ np.maximum(lamp.n_l, 0.0), 0.0, 1.0)) for lamp in s.lamps]
        return Facts(
            sky_share=sky / total,
            openness=sky / max(open_sky, 1e-30) if open_sky > 0.0 else 1.0,
            reflected=float((w @ s.views[0].mirror["both"]).mean()) / diffuse,
            highlights=sum(marks),
            half_angle_deg=max(s.half_angles_deg(), default=0.0),
            contrast=float((w @ np.abs(steady - local)).mean()) / (np.pi * diffuse),
            light_share=[x / total for x in share],
            hidden=[float(w @ (1.0 - lamp.least)) for lamp in s.lamps],
            elevation_deg=[float(np.degrees(np.arcsin(x))) for x in rise],
            light_highlights=marks,
        )


def estimate(scene: Scene, surface: Surface) -> Estimates:
    """Shade the samples; some hundredths of a second."""
    return Estimates(Shading(scene, surface, illumination(scene)))
