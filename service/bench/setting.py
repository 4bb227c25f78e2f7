"""What all measurements of one run share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.bench import material, rates
from service.bench.variants import INT8, Extent, Family, Variant
from service.bench.work import Work
from service.runtime.describe import Description
from service.runtime.networks import Engine

Progress = Callable[[str, float], None]
Launch = Callable[..., Any]

STAGES_SHARE = 0.5
"""Of the progress bar."""


@dataclass
class Setting:
    """What all measurements of a run share."""

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
        """The networks that a variant is of."""
        return next((family for family in self.families if family.name == variant.family), self.first)

    def engine(self, variant: Variant) -> Engine | None:
        """What a variant's networks run on; None where there are none in eight bits."""
        folder = self.family(variant).folder
        if variant.precision in INT8:
            if variant.precision not in self.int8:
                return None
            folder = self.int8[variant.precision]
        return Engine(
            variant.runtime, "bf16" if variant.precision == "bf16" else "fp32", self.threads, folder
        )  # fmt: skip
