"""Scene of a render: environment, point lights, viewpoints and the camera's response.

Positions are metres in head space: origin midway between the eyes, +X the subject's left, +Y up, +Z out of the face.
Radiance is linear sRGB in an arbitrary unit, as the response's exposure scales it. A scene is read from JSON.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

from annotated_types import Ge, Le, MaxLen, MinLen
from pydantic import AfterValidator, ConfigDict, Strict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from service.checks import refused

Triple = tuple[float, float, float]

WHITE: Triple = (1.0, 1.0, 1.0)
BLACK: Triple = (0.0, 0.0, 0.0)

_CHECKED = ConfigDict(extra="forbid", allow_inf_nan=False)
_Metres = Annotated[float, Strict(), Ge(-1e3), Le(1e3)]
_Radiance = Annotated[float, Strict(), Ge(0), Le(1e6)]
_Intensity = Annotated[float, Strict(), Ge(0), Le(1e12)]
_Gain = Annotated[float, Strict(), Ge(0.01), Le(100)]
_Place = tuple[_Metres, _Metres, _Metres]
_Colour = tuple[_Radiance, _Radiance, _Radiance]


def _leads_somewhere(direction: Triple) -> Triple:
    if math.hypot(*direction) < 1e-6:
        raise ValueError("it should be other than zero")
    return direction


@dataclass(frozen=True, config=_CHECKED)
class PointLight:
    """A spherical light of uniform radiance.

    Attributes:
        position_m: its centre, at most 1000 m away.
        intensity: linear RGB; the irradiance on a facing surface at distance d is intensity / d^2.
        radius_m: 0 for a point; shadows soften with it.
    """

    position_m: _Place
    intensity: tuple[_Intensity, _Intensity, _Intensity]
    radius_m: Annotated[float, Strict(), Ge(0), Le(1e3)] = 0.0


@dataclass(frozen=True, config=_CHECKED)
class Softbox:
    """A spherical Gaussian of radiance: radiance * exp(sharpness * (cos - 1)), cos of the angle to its direction."""

    direction: Annotated[_Place, AfterValidator(_leads_somewhere)]
    radiance: _Colour
    sharpness: Annotated[float, Strict(), Ge(0.1), Le(1000)] = 20.0


@dataclass(frozen=True, config=_CHECKED)
class Environment:
    """Distant light from all directions: a shipped image plus an analytic sky, rotated about the vertical and scaled.

    Attributes:
        name: a shipped image (``service.light.environment.names``), or None for the analytic sky alone.
        zenith, horizon, ground: linear radiance of the analytic sky; uniform light if all are equal.
        softboxes: bright spots added to it.
        rotation_deg: rotation about +Y; positive moves light from in front of the face to the subject's left.
        strength: factor of all radiance.
    """

    name: str | None = None
    zenith: _Colour = BLACK
    horizon: _Colour = BLACK
    ground: _Colour = BLACK
    softboxes: Annotated[tuple[Softbox, ...], MaxLen(64)] = ()
    rotation_deg: Annotated[float, Strict(), Ge(-3600), Le(3600)] = 0.0
    strength: _Radiance = 1.0


@dataclass(frozen=True, config=_CHECKED)
class Response:
    """The camera's tone curve: coded value = sRGB(clip(exposure * white_balance * light)) ** gamma.

    Attributes:
        exposure: factor, or None to choose it automatically (see ``target``).
        target: sRGB-coded level in (0, 1) of the face's 90th percentile where exposure is None.
        white_balance: factors of linear RGB.
        shoulder: 0 for a hard clip; otherwise values above 1 - shoulder approach 1 smoothly.
        gamma: exponent of the coded value.
    """

    exposure: Annotated[float, Strict(), Ge(0), Le(1e9)] | None = None
    target: Annotated[float, Strict(), Ge(0.01), Le(0.99)] = 0.75
    white_balance: tuple[_Gain, _Gain, _Gain] = WHITE
    shoulder: Annotated[float, Strict(), Ge(0), Le(0.9)] = 0.0
    gamma: Annotated[float, Strict(), Ge(0.3), Le(3)] = 1.0


DEFAULT_VIEW: Triple = (0.0, 0.0, 1.2)
"""Viewpoint in metres, head space: in front of the face at portrait distance."""


@dataclass(frozen=True, config=_CHECKED)
class Scene:
    """Light, viewpoints and camera. Several viewpoints simulate a texture blended from several photos."""

    environment: Environment = Environment()
    lights: Annotated[tuple[PointLight, ...], MaxLen(64)] = ()
    viewpoints: Annotated[tuple[_Place, ...], MinLen(1), MaxLen(16)] = (DEFAULT_VIEW,)
    response: Response = Response()

    def dark(self) -> bool:
        """Whether no light comes from anywhere."""
        sky = self.environment
        colours = (sky.zenith, sky.horizon, sky.ground, *(box.radiance for box in sky.softboxes))
        lit = sky.strength > 0 and (sky.name is not None or any(map(any, colours)))
        return not lit and not any(any(light.intensity) for light in self.lights)

    def exposed(self, exposure: float) -> Scene:
        """The same scene with the exposure fixed."""
        return dataclasses.replace(self, response=dataclasses.replace(self.response, exposure=exposure))

    @classmethod
    def from_json(cls, text: str) -> Scene:
        """A scene from JSON; missing fields have their defaults.

        UsageError: not JSON, a field that does not exist, or a value out of range; the message names it.
        """
        try:
            return TypeAdapter(cls).validate_json(text)
        except ValidationError as error:
            raise refused(error, cls, "scene") from error


BRIGHT = 0.9
"""Quantile of the face's luminance that the exposure brings to the response's target."""


def level_of(response: Response) -> float:
    """Linear value that the response's tone curve maps to its target."""
    coded = response.target ** (1.0 / response.gamma)
    linear = coded / 12.92 if coded <= 0.04045 else ((coded + 0.055) / 1.055) ** 2.4
    knee = 1.0 - response.shoulder
    if response.shoulder > 0.0 and linear > knee:
        return float(knee - response.shoulder * math.log(max(1.0 - (linear - knee) / response.shoulder, 1e-6)))
    return float(linear)


def exposed_for(scene: Scene, bright: float) -> Scene:
    """The scene with the exposure that maps a linear luminance to the response's target; 1 in complete darkness."""
    return scene.exposed(min(level_of(scene.response) / bright, 1e9) if bright > 1e-9 else 1.0)
