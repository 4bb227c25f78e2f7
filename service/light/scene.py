"""Scene of a render: environment, point lights, viewpoints and the camera's response.

Positions are metres in head space: origin midway between the eyes, +X the subject's left, +Y up, +Z out of the face.
Radiance is linear sRGB in an arbitrary unit, as the response's exposure scales it. A scene is exchanged as JSON.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from service.checks import shown
from service.errors import UsageError

Triple = tuple[float, float, float]

WHITE: Triple = (1.0, 1.0, 1.0)
BLACK: Triple = (0.0, 0.0, 0.0)


def _fault(what: str, value: object, wanted: str, place: str | None = None) -> UsageError:
    """What is wrong with a value; its place in the scene is its name, the last word, unless that is given."""
    if place is None:
        place = what.rpartition(" ")[2].replace("[", "/").replace("]", "")
    return UsageError(f"scene: {what} is {shown(value)}; it should be {wanted}", field=place)


@contextlib.contextmanager
def _within(place: str) -> Iterator[None]:
    """Let faults know that they are in a part of the scene."""
    try:
        yield
    except UsageError as fault:
        raise UsageError(fault.message, field=f"{place}/{fault.extra.get('field', '')}".strip("/")) from fault


def _number(value: object, what: str, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise _fault(what, value, f"a number from {low:g} to {high:g}")
    return float(value)


def _triple(value: object, what: str, low: float, high: float) -> Triple:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise _fault(what, value, "three numbers")
    a, b, c = (_number(v, f"{what}[{i}]", low, high) for i, v in enumerate(value))
    return a, b, c


@dataclass(frozen=True)
class PointLight:
    """A spherical light of uniform radiance.

    Attributes:
        position_m: its centre, at most 1000 m away.
        intensity: linear RGB; the irradiance on a facing surface at distance d is intensity / d^2.
        radius_m: 0 for a point; shadows soften with it.
    """

    position_m: Triple
    intensity: Triple
    radius_m: float = 0.0

    def __post_init__(self) -> None:
        _triple(self.position_m, "position_m", -1e3, 1e3)
        _triple(self.intensity, "intensity", 0.0, 1e12)
        _number(self.radius_m, "radius_m", 0.0, 1e3)


@dataclass(frozen=True)
class Softbox:
    """A spherical Gaussian of radiance: radiance * exp(sharpness * (cos - 1)), cos of the angle to its direction."""

    direction: Triple
    radiance: Triple
    sharpness: float = 20.0

    def __post_init__(self) -> None:
        _triple(self.direction, "softbox direction", -1e3, 1e3)
        if math.hypot(*self.direction) < 1e-6:
            raise _fault("softbox direction", self.direction, "other than zero")
        _triple(self.radiance, "softbox radiance", 0.0, 1e6)
        _number(self.sharpness, "softbox sharpness", 0.1, 1000.0)


@dataclass(frozen=True)
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
    zenith: Triple = BLACK
    horizon: Triple = BLACK
    ground: Triple = BLACK
    softboxes: tuple[Softbox, ...] = ()
    rotation_deg: float = 0.0
    strength: float = 1.0

    def __post_init__(self) -> None:
        if self.name is not None and not isinstance(self.name, str):
            raise _fault("environment name", self.name, "a string or null")
        for name in ("zenith", "horizon", "ground"):
            _triple(getattr(self, name), name, 0.0, 1e6)
        if len(self.softboxes) > 64:
            raise _fault("number of softboxes", len(self.softboxes), "at most 64")
        _number(self.rotation_deg, "rotation_deg", -3600.0, 3600.0)
        _number(self.strength, "strength", 0.0, 1e6)


@dataclass(frozen=True)
class Response:
    """The camera's tone curve: coded value = sRGB(clip(exposure * white_balance * light)) ** gamma.

    Attributes:
        exposure: factor, or None to choose it automatically (see ``target``).
        target: sRGB-coded level in (0, 1) of the face's 90th percentile where exposure is None.
        white_balance: factors of linear RGB.
        shoulder: 0 for a hard clip; otherwise values above 1 - shoulder approach 1 smoothly.
        gamma: exponent of the coded value.
    """

    exposure: float | None = None
    target: float = 0.75
    white_balance: Triple = WHITE
    shoulder: float = 0.0
    gamma: float = 1.0

    def __post_init__(self) -> None:
        if self.exposure is not None:
            _number(self.exposure, "exposure", 0.0, 1e9)
        _number(self.target, "target", 0.01, 0.99)
        _triple(self.white_balance, "white_balance", 0.01, 100.0)
        _number(self.shoulder, "shoulder", 0.0, 0.9)
        _number(self.gamma, "gamma", 0.3, 3.0)


DEFAULT_VIEW: Triple = (0.0, 0.0, 1.2)
"""Viewpoint in metres, head space: in front of the face at portrait distance."""


@dataclass(frozen=True)
class Scene:
    """Light, viewpoints and camera. Several viewpoints simulate a texture blended from several photos."""

    environment: Environment = Environment()
    lights: tuple[PointLight, ...] = ()
    viewpoints: tuple[Triple, ...] = (DEFAULT_VIEW,)
    response: Response = Response()

    def __post_init__(self) -> None:
        if not 1 <= len(self.viewpoints) <= 16:
            raise _fault("viewpoints", self.viewpoints, "a list of 1 to 16 points")
        for point in self.viewpoints:
            _triple(point, "viewpoint", -1e3, 1e3)
        if len(self.lights) > 64:
            raise _fault("number of lights", len(self.lights), "at most 64")

    def exposed(self, exposure: float) -> Scene:
        """The same scene with the exposure fixed."""
        return dataclasses.replace(self, response=dataclasses.replace(self.response, exposure=exposure))

    def to_json(self) -> str:
        """As JSON, every field."""
        return json.dumps(dataclasses.asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str) -> Scene:
        """A scene from JSON; missing fields have their defaults.

        Raises:
            UsageError: not JSON, a field that does not exist, or a value out of range; the message names it.
        """
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as fault:
            raise UsageError(f"scene: not JSON: {fault}") from fault
        fields = _known(data, cls, "scene")
        if "environment" in fields:
            with _within("environment"):
                fields["environment"] = _environment(fields["environment"])
        if "lights" in fields:
            fields["lights"] = _all(fields["lights"], PointLight, "lights", "light")
        if "viewpoints" in fields:
            points = enumerate(_list(fields["viewpoints"], "viewpoints"))
            fields["viewpoints"] = tuple(_triple(point, f"viewpoints[{n}]", -1e3, 1e3) for n, point in points)
        if "response" in fields:
            with _within("response"):
                fields["response"] = _build(fields["response"], Response, "response")
        return cls(**fields)


def _all(data: object, kind: type, what: str, one: str) -> tuple[Any, ...]:
    built = []
    for number, item in enumerate(_list(data, what)):
        with _within(f"{what}/{number}"):
            built.append(_build(item, kind, one))
    return tuple(built)


def _list(value: object, what: str) -> list[Any]:
    if not isinstance(value, list):
        raise _fault(what, value, "a list")
    return value


def _known(data: object, kind: type, what: str) -> dict[str, Any]:
    if not isinstance(data, Mapping):
        raise _fault(what, data, "an object with named fields", "")
    names = [field.name for field in dataclasses.fields(kind)]
    unknown = sorted(set(data) - set(names))
    if unknown:
        words = f"scene: {what} has no field {unknown[0][:40]!r}; it has {', '.join(names)}"
        raise UsageError(words, field=unknown[0][:40])
    return dict(data)


def _build(data: object, kind: type, what: str) -> Any:
    fields = _known(data, kind, what)
    for name, value in fields.items():
        if isinstance(value, list):
            fields[name] = tuple(value)
    for field in dataclasses.fields(kind):
        if field.default is dataclasses.MISSING and field.name not in fields:
            raise UsageError(f"scene: {what} has no {field.name}, which it needs", field=field.name)
    return kind(**fields)


def _environment(data: object) -> Environment:
    fields = _known(data, Environment, "environment")
    fields["softboxes"] = _all(fields.get("softboxes", []), Softbox, "softboxes", "softbox")
    built: Environment = _build(fields, Environment, "environment")
    return built


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
