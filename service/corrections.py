"""Corrections: rules that alter what a network or the photo gave, each with a name, a switch and a count.

``service.reflectance.albedo.diffuse_albedo.REGISTRY`` lists all of them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from service import manifest
from service.arrays import Float32
from service.colour import linear_to_srgb
from service.image_filters import most

SEEN_CHANGE = 1 / 255
"""Change of an sRGB value from which a texel counts as changed: one step of an 8-bit map."""


@dataclass(frozen=True, kw_only=True)
class Correction:
    """One rule.

    Attributes:
        name: lower case, words joined by hyphens; what ``--without`` takes.
        mends: what is wrong without it, one sentence.
        cases: groups of photos of ``benchmarks.corrections`` on which it has to gain.
    """

    name: str
    mends: str
    cases: tuple[str, ...] = ()


class Ledger:
    """Which corrections are switched off, and what the others changed."""

    def __init__(self, without: Collection[str] = ()) -> None:
        """``without`` has the names of those that do not run."""
        self.without = frozenset(without)
        self._counts: dict[str, tuple[int, int]] = {}

    def runs(self, correction: Correction) -> bool:
        """Whether it is switched on."""
        return correction.name not in self.without

    def count(self, correction: Correction, changed: int, texels: int) -> None:
        """Add to what a correction changed; a map that is worked on in tiles is told tile by tile."""
        before = self._counts.get(correction.name, (0, 0))
        self._counts[correction.name] = (before[0] + int(changed), before[1] + int(texels))

    @property
    def applied(self) -> tuple[manifest.CorrectionEntry, ...]:
        """In the order in which they first ran."""
        return tuple(manifest.CorrectionEntry(name, *counts) for name, counts in self._counts.items())


def changed_texels(before: Float32, after: Float32) -> tuple[int, int]:
    """Texels of linear RGB maps (..., 3) that differ by more than ``SEEN_CHANGE`` as sRGB; and how many there are."""
    coded = most(np.abs(linear_to_srgb(after) - linear_to_srgb(before)))
    return int((coded > SEEN_CHANGE).sum()), coded.size
