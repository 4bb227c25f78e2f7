"""Corrections of the light that delta's context network finds on the whole chart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Float32
from service.colour import linear_to_srgb
from service.ledger import SEEN_CHANGE, Correction, Ledger
from service.reflectance.completion import AlbedoPrior, albedo_prior

BORDER = 3
"""Width of the border over which lit skin fades out, texels of the context's chart, 1.5 mm each."""
LEAST_BEARD = 40.0
"""Such texels of beard from which a head counts as bearded: a square centimetre."""


@dataclass(frozen=True)
class ChartLight:
    """Light on the chart, and what tells where it is to be believed.

    Attributes:
        light: (3, h, w) float32 natural logarithm of the linear RGB light, as far as it has been corrected.
        found: (3, h, w) the same as it is on lit skin, before it was continued to all else.
        texture: (3, h, w) float32 linear RGB, the photo's light in it.
        lit: (h, w) in [0, 1], skin in the photo's light.
        inside: (h, w) in [0, 1], islands of the chart.
        inpainted: (h, w) in [0, 1], skin that no photo showed, lids left out.
        shown: (h, w) in [0, 1], at least :attr:`weight`: what of the head's own surface the photo shows, beards too.
    """

    light: Float32
    found: Float32
    texture: Float32
    lit: Float32
    inside: Float32
    inpainted: Float32
    shown: Float32

    @property
    def weight(self) -> Float32:
        """(h, w) in [0, 1]: lit skin inside the islands."""
        return self.lit * self.inside

    @property
    def bearded(self) -> bool:
        """Whether the photo shows a beard: what is shown beside lit skin and its soft border."""
        import cv2

        skin = cv2.dilate(self.lit, np.ones((2 * BORDER + 1, 2 * BORDER + 1), np.uint8))
        return float(np.clip((self.shown - skin) * self.inside, 0, None).sum()) > LEAST_BEARD

    @property
    def prior(self) -> AlbedoPrior | None:
        """What completes albedo like this head's; None on another chart than the one that it was learnt on."""
        found = albedo_prior(self.bearded)
        return found if found.is_of(self.inside) else None

    @property
    def coded_albedo(self) -> Float32:
        """(3, h, w) sRGB in [0, 1] of the albedo that the light leaves of the texture."""
        return linear_to_srgb(self.texture * np.exp(-np.clip(self.light, -6, 6)))


@dataclass(frozen=True, kw_only=True)
class LightCorrection(Correction):
    """A correction of light.

    Attributes:
        apply: (3, h, w) log light in place of ``ChartLight.light``.
    """

    apply: Callable[[ChartLight], Float32]


def corrected(state: ChartLight, corrections: Sequence[LightCorrection], ledger: Ledger) -> ChartLight:
    """The light after all corrections that are switched on, in order; the ledger counts texels of the chart."""
    for one in corrections:
        if not ledger.runs(one):
            continue
        after = replace(state, light=one.apply(state))
        if after.light is not state.light:
            moved = np.abs(after.coded_albedo - state.coded_albedo).max(0) > SEEN_CHANGE
            ledger.count(one, int((moved & (state.inside > 0.5)).sum()), state.lit.size)
        else:
            ledger.count(one, 0, state.lit.size)
        state = after
    return state
