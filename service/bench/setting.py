"""Context of the measurements of one run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.bench import material, rates
from service.bench.variants import INT8, Extent, Family, Variant
from service.bench.work import Work
from service.runtime.networks import Description, Engine

Progress = Callable[[str, float], None]
Launch = Callable[..., Any]

STAGES_SHARE = 0.5
"""Share of the progress bar for the stages; the rest is for whole runs."""


@dataclass
class Setting:
    """Context of the measurements of one run: extent, networks, material, machine; notes and caches are added to."""

    extent: Extent
    families: Sequence[Family]
    folder: Path
    launch: Launch
    photo: bytes
    threads: int
    rates: rates.Rates
    material: material.Material
    notes: list[str] = field(default_factory=list)
    int8: dict[str, Path] = field(default_factory=dict)
    works: dict[str, tuple[Work, Description]] = field(default_factory=dict)

    @property
    def first(self) -> Family:
        """The family that is the reference."""
        return self.families[0]

    def family(self, variant: Variant) -> Family:
        """The family of a variant's networks."""
        return next((family for family in self.families if family.name == variant.family), self.first)

    def engine(self, variant: Variant) -> Engine | None:
        """Engine of a variant's networks; None where they were not quantised."""
        folder = self.family(variant).folder
        if variant.precision in INT8:
            if variant.precision not in self.int8:
                return None
            folder = self.int8[variant.precision]
        return Engine(
            variant.runtime, "bf16" if variant.precision == "bf16" else "fp32", self.threads, folder
        )  # fmt: skip
