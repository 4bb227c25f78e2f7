"""Which stages the requested maps need."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from service.map_registry import MAPS
from service.runtime.network_registry import networks_of


@dataclass(frozen=True)
class PlannedStage:
    """One stage.

    Attributes:
        needs: stages whose results it reads (AvatarMe, figure 3).
        cost: approximate time relative to the other stages, for reports of progress only.
    """

    needs: tuple[str, ...]
    cost: float


STAGES = {
    "super_resolution": PlannedStage((), 4.0),
    "diffuse_albedo": PlannedStage(("super_resolution",), 8.0),
    "specular_albedo": PlannedStage(("diffuse_albedo",), 4.0),
    "specular_normal": PlannedStage(("diffuse_albedo",), 8.0),
    "diffuse_normal": PlannedStage(("diffuse_albedo",), 4.0),
    "displacement": PlannedStage(("specular_normal",), 8.0),
}
"""In the order in which they run."""


@dataclass(frozen=True)
class ReflectancePlan:
    """What will run.

    Attributes:
        stages: in the order in which they run.
    """

    stages: tuple[str, ...]

    @classmethod
    def of(cls, maps: Collection[str], *, super_resolution: bool = True) -> ReflectancePlan:
        """Stages that maps need; names of maps that need none are ignored."""
        wanted = {one.needs for one in MAPS if one.name in maps and one.needs}
        for name in reversed(STAGES):
            if name in wanted:
                wanted.update(STAGES[name].needs)
        if not super_resolution:
            wanted.discard("super_resolution")
        return cls(tuple(stage for stage in STAGES if stage in wanted))

    @property
    def networks(self) -> tuple[str, ...]:
        """Networks that will be loaded, in order."""
        return networks_of(*self.stages)

    def shares(self) -> dict[str, float]:
        """Approximate share of the total time that each stage takes."""
        total = sum(STAGES[stage].cost for stage in self.stages)
        return {stage: STAGES[stage].cost / total for stage in self.stages}
