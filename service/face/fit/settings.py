"""The knobs of the fit, each a point on a measured curve (``docs/fit-accuracy.md``)."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import Strict
from pydantic.dataclasses import dataclass

from service.checks import CHECKED, Checked, Right

Refine = Literal["landmarks", "dense", "full"]
Iterations = Annotated[int, Strict(), Ge(1), Le(1000), Right("a whole number from 1 to 1000")]
IdentityComponents = Annotated[int, Strict(), Ge(0), Le(10_000), Right("a whole number from 0 to 10000")]
Switch = Annotated[bool, Strict(), Right("true or false")]


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class FitSettings(Checked):
    """How hard to try.

    Attributes:
        iterations: damped least-squares steps of the landmark stage, >= 1.
        identity_components: how many identity components to fit, >= 0; more than the head has means all.
        beyond: modes of free form beyond the identity components, >= 0 (``service.face.fit.basis``); "full" has them.
        refine: "landmarks" stops after the landmarks, "dense" follows the reader with the model's components, "full"
            bends the head beyond them as well.
        scores: the expression's prior lies about the scores that were read; without it about 0.
        normals: "dense" and "full" follow the normals that were read besides the places.
        identity_prior: weight of the Gaussian prior on identity, > 0; higher keeps nearer to the average head.
        expression_prior: standard deviation of an expression unit about its score, or about 0 without one, > 0.
        distance_m: most likely distance of camera and face in metres, where EXIF does not give the focal length.

    Raises:
        UsageError: a value is out of range; the message has the value and what would be right.
    """

    iterations: Iterations = 8
    identity_components: IdentityComponents = 80
    beyond: IdentityComponents = 60
    refine: Refine = "full"
    scores: Switch = True
    normals: Switch = True
    identity_prior: Annotated[float, Strict(), Gt(0), Lt(1e6), Right("a number between 0 and 1e6")] = 1.0
    expression_prior: Annotated[float, Strict(), Gt(0), Lt(1e3), Right("a number between 0 and 1000")] = 0.5
    distance_m: Annotated[float, Strict(), Ge(0.2), Le(20), Right("a number from 0.2 to 20 metres")] = 1.2
