"""Upper bound of the mean absolute error that leaving out an effect of light causes on a surface.

The bound has to hold for the whole surface although only some hundred points of it are shaded. It is
``FLOOR + MARGIN * (mean + 2 standard errors) + rare``:

- The mean is over the samples, each at several places of its fine relief. Where the shading is uncertain (shadows
  between the directions of known visibility, horizons between azimuths) the worse of two assumptions counts.
- The standard error is that of the mean over the samples.
- ``rare`` covers what no sample shows: a shadow or a sparkle on less than one point in K may be missed by all K, and
  then mean and standard error are both 0. By Laplace's rule of succession one more sample is added with the largest
  error possible: for shadows that of a point without the lamp, for other effects that of the worst sample.
- ``MARGIN`` covers the approximations of the shading (``service.light.shading``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float64
from service.light.environment import illumination
from service.light.scene import Scene
from service.light.shading import BRIGHT, DARK, GONE, LOW, Item, Shading, develop
from service.light.surface import SurfaceSamples

__all__ = ["Estimates", "Facts", "develop", "estimate"]

MARGIN = 1.4
"""Factor of the bound for the approximations of the shading."""
FLOOR = 0.01
"""Constant part of every bound, 1/255 of sRGB."""
MIRROR_DOUBT = 0.04
"""Relative difference of the sky's reflection between one lobe and two, which the few directions cannot resolve."""

PROFILE_DOUBT = 0.2
"""Relative error of the change by scattering: three rings miss features narrower than their spacing."""

_SHADOWS = ("shadows", "relief_shadows")
_ASSUMPTIONS: dict[str, tuple[tuple[str, ...], ...]] = {
    "shadows": ((DARK,),),
    "relief_shadows": ((LOW,), (LOW, BRIGHT)),
    "specular": ((), (BRIGHT,)),
}
"""Assumptions about a light under which the change is computed when an effect of it is left out; the worst counts.

In full shadow nothing of a lamp is left to lose, so highlights and relief shadows are also tried in the lightest.
"""


@dataclass(frozen=True)
class Facts:
    """Numbers that explain a plan: shares of the light, means over the samples; lists have one entry per light."""

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
            change = (1.0 + PROFILE_DOUBT) * change + self.shading.soft_edges()
        if ("second_lobe", None) in items:
            mirror = np.abs(self.shading.picture({("reflection", None)}) - self._whole)
            change = change + MIRROR_DOUBT * mirror
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

    def facts(self) -> Facts:
        """Numbers that explain a plan."""
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


def estimate(scene: Scene, surface: SurfaceSamples) -> Estimates:
    """Shade the samples; takes some hundredths of a second."""
    return Estimates(Shading(scene, surface, illumination(scene)))
