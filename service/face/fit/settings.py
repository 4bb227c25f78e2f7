"""The knobs of the fit, each a point on a measured curve (``docs/fit-accuracy.md``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from service.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How hard to try.

    Attributes:
        iterations: damped least-squares steps of the landmark stage, >= 1.
        identity_components: how many identity components to fit, >= 0; more than the head has means all.
        refine: "landmarks" stops after the landmarks, "pixels" goes on with shading.
        identity_prior: weight of the Gaussian prior on identity, > 0; higher keeps nearer to the average head.
        expression_prior: standard deviation of an expression unit, > 0.
        distance_m: most likely distance of camera and face in metres, where EXIF does not give the focal length.
    """

    iterations: int = 8
    identity_components: int = 80
    refine: Literal["landmarks", "pixels"] = "pixels"
    identity_prior: float = 1.0
    expression_prior: float = 0.5
    distance_m: float = 1.2

    def __post_init__(self) -> None:
        checks = {
            "iterations": (self.iterations >= 1, "at least 1"),
            "identity_components": (self.identity_components >= 0, "at least 0"),
            "identity_prior": (0 < self.identity_prior < 1e6, "between 0 and 1e6"),
            "expression_prior": (0 < self.expression_prior < 1e3, "between 0 and 1000"),
            "distance_m": (0.2 <= self.distance_m <= 20, "between 0.2 and 20 metres"),
            "refine": (self.refine in ("landmarks", "pixels"), "'landmarks' or 'pixels'"),
        }
        for name, (fine, right) in checks.items():
            if not fine:
                raise UsageError(f"{name} is {getattr(self, name)!r}; it has to be {right}")
