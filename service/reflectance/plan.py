"""Which stages the requested maps need."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

STAGES = (
    "super_resolution", "diffuse_albedo", "specular_albedo", "specular_normal", "diffuse_normal", "displacement",
)  # fmt: skip
"""In the order in which they run."""

ROLES = STAGES[1:]
"""Reflectance maps that can be requested."""

SURFACE: dict[str, tuple[str, ...]] = {
    "roughness": (), "cavity": ("displacement",), "thickness": (), "albedo_error": ("diffuse_albedo",),
}  # fmt: skip
"""Maps made without networks of their own, and the reflectance map that each needs."""

NEEDS: dict[str, tuple[str, ...]] = {
    "super_resolution": (),
    "diffuse_albedo": ("super_resolution",),
    "specular_albedo": ("diffuse_albedo",),
    "specular_normal": ("diffuse_albedo",),
    "diffuse_normal": ("diffuse_albedo",),
    "displacement": ("specular_normal",),
}
"""Stages whose results a stage reads (AvatarMe, figure 3)."""

NETWORKS: dict[str, tuple[str, ...]] = {
    "super_resolution": ("zeta_body", "zeta_tail"),
    "diffuse_albedo": ("delta_context", "delta"),
    "specular_albedo": ("psi",),
    "specular_normal": ("rho",),
    "diffuse_normal": ("sigma",),
    "displacement": (),
}
"""Networks that a stage loads."""

COST: dict[str, float] = {
    "super_resolution": 4.0, "diffuse_albedo": 8.0, "specular_albedo": 4.0, "specular_normal": 8.0,
    "diffuse_normal": 4.0, "displacement": 8.0,
}  # fmt: skip
"""Approximate time of each stage relative to the others, for reports of progress only."""


@dataclass(frozen=True)
class Plan:
    """What will run.

    Attributes:
        stages: in the order in which they run.
        keep_cliffs: whether displacement keeps depth discontinuities, ``service.reflectance.relief.integration``.
    """

    stages: tuple[str, ...]
    keep_cliffs: bool = False

    @classmethod
    def of(cls, roles: Collection[str], *, super_resolution: bool = True, keep_cliffs: bool = False) -> Plan:
        """Stages that the maps ``roles`` need; names of other maps are ignored."""
        wanted = {need for role in roles for need in SURFACE.get(role, (role,)) if need in ROLES}
        waiting = list(wanted)
        while waiting:
            new = [stage for stage in NEEDS[waiting.pop()] if stage not in wanted]
            wanted.update(new)
            waiting += new
        if not super_resolution:
            wanted.discard("super_resolution")
        return cls(tuple(stage for stage in STAGES if stage in wanted), keep_cliffs)

    @property
    def networks(self) -> tuple[str, ...]:
        """Networks that will be loaded, in order."""
        return tuple(name for stage in self.stages for name in NETWORKS[stage])

    def shares(self) -> dict[str, float]:
        """Approximate share of the total time that each stage takes."""
        total = sum(COST[stage] for stage in self.stages)
        return {stage: COST[stage] / total for stage in self.stages}
