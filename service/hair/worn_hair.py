"""What a head wears: strands in their colour, what they are called, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    asked: str
    groom: Groom | None
    kind: str
    kinds: dict[str, float]
    seen: Float32
    agreement: float = 0.0
    doubts: tuple[str, ...] = ()

    @property
    def bald_beneath(self) -> bool:
        """Whether the skin is to be painted without hair: strands are worn, or hair is not wanted."""
        return self.groom is not None or self.asked == "none"
