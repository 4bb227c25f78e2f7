"""What a head wears: strands in their colour, what they are called, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float32
from service.hair.groom import Groom


@dataclass(frozen=True)
class WornHair:
    """Hair of one photo: what the stage "hair" hands on.

    Attributes:
        asked: the option ``hair``.
        groom: strands on the fitted head at rest, in their colour; None on a head that wears none.
        kind: what one would call it, a key of ``kinds`` or, where it was asked for, the name of a style.
        kinds: probability of each kind in [0, 1], sum 1; empty where nothing was read.
        seen: (N,) float32 in [0, 1], share of each strand that the photo shows; the rest is a likely one.
        agreement: intersection over union of its silhouette and the photo's hair, in [0, 1]; 0 where none was compared.
        doubts: stable codes for the manifest; docs/hair.md lists them.
        in_photo_light: whether the colour of the strands still has the photo's light in it.
    """

    asked: str
    groom: Groom | None
    kind: str
    kinds: dict[str, float]
    seen: Float32
    agreement: float = 0.0
    doubts: tuple[str, ...] = ()
    in_photo_light: bool = False

    @property
    def root_colour(self) -> Float32:
        """(3,) float32 linear RGB, the usual colour at the roots; dark brown without strands."""
        if self.groom is None or not len(self.groom):
            return np.array([0.05, 0.03, 0.02], np.float32)
        return np.asarray(np.median(self.groom.colour.linear()[:, 0], 0), np.float32)
