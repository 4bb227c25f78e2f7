"""What a fit is asked for and what it gives; the knobs are points on measured curves (``docs/fit-accuracy.md``)."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import Strict
from pydantic.dataclasses import dataclass

from service.arrays import Float32, Float64
from service.checks import CHECKED, Checked, Right
from service.face.features.eyes import Gaze
from service.geometry.camera import Camera
from service.words import WarningCode

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
        beyond: modes of free form beyond the identity components, >= 0 (``landmark_fit.modes``); "full" has them,
            and twice as many for several photos.
        refine: "landmarks" stops after the landmarks, "dense" follows the reader with the model's components, "full"
            bends the head beyond them as well.
        normals: "dense" and "full" follow the normals that were read besides the places.
        identity_prior: weight of the Gaussian prior on identity, > 0; higher keeps nearer to the average head.

    Raises:
        UsageError: a value is out of range; the message has the value and what would be right.
    """

    iterations: Iterations = 8
    identity_components: IdentityComponents = 80
    beyond: IdentityComponents = 60
    refine: Refine = "full"
    normals: Switch = True
    identity_prior: Annotated[float, Strict(), Gt(0), Lt(1e6), Right("a number between 0 and 1e6")] = 1.0


@dataclasses.dataclass(frozen=True)
class Fit:
    """A head model placed in a photo.

    Attributes:
        camera: pose and focal length.
        identity: (k,) float64 standard deviations.
        expression: (E,) float64 activations in [0, 1].
        vertices: (V, 3) float32 metres, head space, the photo's expression.
        neutral: (V, 3) float32 metres, head space, no expression.
        light: (9, 3) float64 spherical-harmonic radiance, linear RGB, camera frame: ``sh_basis(n) @ light`` of
            ``service.light.formulas`` is irradiance over pi, scaled so that the seen skin has a mean luminance of
            one. None if the fit stopped at the landmarks, or, with the warning ``no-light``, if too little lit skin is
            seen.
        landmark_rms_px: root mean square distance of trusted landmarks, photo pixels.
        inter_ocular_px: distance of the eye centres in the photo plane, scaled up to a frontal view.
        warnings: ``low-confidence`` means the fit is not to be trusted.
        gaze: where the eyes look, already part of ``expression``; None for a head without eyeballs.
        eye_light: (3,) linear RGB radiance in the photo of a white diffuse surface in place of the sclera, estimated
            from sclera and teeth (``service.face.features.eye_colours``); None if neither can be measured.
        cheek: (3,) float32 sRGB of the cheeks; None if the photo shows neither.
        tooth: (3,) float32 sRGB of the teeth between the lips; None if none are seen.
        iris: (3,) float32 sRGB of the irises; None if none are seen.
        sclera: (3,) float32 sRGB of the sclera; None if it is not seen, or told no light: then it is lids and lashes in
            part, and dark eyes in the shade of lids, measured against those, would be pale ones.
    """

    camera: Camera
    identity: Float64
    expression: Float64
    vertices: Float32
    neutral: Float32
    light: Float64 | None
    landmark_rms_px: float
    inter_ocular_px: float
    warnings: tuple[WarningCode, ...] = ()
    gaze: Gaze | None = None
    eye_light: Float64 | None = None
    cheek: Float32 | None = None
    tooth: Float32 | None = None
    iris: Float32 | None = None
    sclera: Float32 | None = None
