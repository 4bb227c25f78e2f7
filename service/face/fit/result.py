"""Result of the fit."""

from __future__ import annotations

from dataclasses import dataclass, field

from service.arrays import Float32, Float64
from service.face.features.eyes import Gaze
from service.geometry.camera import Camera


@dataclass(frozen=True)
class Fit:
    """A head model placed in a photo.

    Attributes:
        camera: pose and focal length.
        identity: (k,) float64 standard deviations.
        expression: (E,) float64 activations in [0, 1].
        vertices: (V, 3) float32 metres, head space, the photo's expression.
        neutral: (V, 3) float32 metres, head space, no expression.
        light: (9, 3) float64 spherical-harmonic radiance, linear RGB, camera frame: ``sh_basis(n) @ light`` of
            ``service.light.harmonics`` is irradiance over pi, scaled so that the seen skin has a mean luminance of
            one. None if the fit stopped at the landmarks, or, with the warning ``no-light``, if too little lit skin is
            seen.
        landmark_rms_px: root mean square distance of trusted landmarks, photo pixels.
        inter_ocular_px: distance of the eye centres in the photo plane, scaled up to a frontal view.
        warnings: stable codes; ``low-confidence`` means the fit is not to be trusted, ``gaze-not-seen`` that the eyes
            are set straight ahead for want of a visible iris.
        gaze: where the eyes look, already part of ``expression``; None for a head without eyeballs.
        eye_light: (3,) linear RGB radiance in the photo of a white diffuse surface in place of the sclera, estimated
            from sclera and teeth (``service.face.features.white_reference``); None if neither can be measured.
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
    warnings: tuple[str, ...] = field(default=())
    gaze: Gaze | None = None
    eye_light: Float64 | None = None
    cheek: Float32 | None = None
    tooth: Float32 | None = None
    iris: Float32 | None = None
    sclera: Float32 | None = None
