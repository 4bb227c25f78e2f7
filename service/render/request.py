"""Options of a render, from code or from untrusted JSON, checked before any work starts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

from service.checks import shown
from service.errors import UsageError
from service.light.scene import Environment, Scene

SMALLEST_SIDE, LARGEST_SIDE = 16, 4096
LARGEST_PIXELS = 4096 * 4096
BACKGROUNDS = ("black", "transparent", "environment")
FINEST = 3
"""Most samples per pixel and axis."""

STUDIO = Scene(Environment(name="studio"))
"""The default scene."""


@dataclass(frozen=True, kw_only=True)
class RenderRequest:
    """One picture.

    Attributes:
        scene: light and camera response; its first viewpoint is the camera's place where ``view`` is None.
        size: (width, height) in pixels, each 16 to 4096.
        view: "front", "three-quarter", "left", "right", "back", or degrees about the vertical as text; None for the
            scene's viewpoint.
        background: behind the head: "black", "transparent" (the PNG gets an alpha channel), or "environment".
        samples: per pixel and axis, 1 to 3.
        tolerance: largest mean error by leaving out effects, in 1/255 of sRGB; 0 leaves out only what changes
            nothing.

    Raises:
        UsageError: a value is out of range; the message has the value and what would be right.
    """

    scene: Scene = STUDIO
    size: tuple[int, int] = (768, 1024)
    view: str | None = None
    background: Literal["black", "transparent", "environment"] = "black"
    samples: int = 2
    tolerance: float = 1.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        width, height = self.size
        if not all(SMALLEST_SIDE <= side <= LARGEST_SIDE for side in self.size):
            words = f"size is {shown(self.size)}; each side has to be {SMALLEST_SIDE} to {LARGEST_SIDE} pixels"
            raise UsageError(words, field="size")
        if self.background not in BACKGROUNDS:
            words = f"background is {shown(self.background)}; it has to be one of {', '.join(BACKGROUNDS)}"
            raise UsageError(words, field="background")
        if self.samples not in range(1, FINEST + 1):
            raise UsageError(
                f"samples is {shown(self.samples)}; it has to be 1 to {FINEST} per pixel and axis", field="samples"
            )
        if width * height * self.samples**2 > LARGEST_PIXELS:
            raise UsageError(
                f"size {width}x{height} with {self.samples}x{self.samples} samples per pixel is {width * height} x "
                f"{self.samples**2} samples; at most {LARGEST_PIXELS} are computed",
                field="size",
            )
        if not 0.0 <= self.tolerance <= 255.0:
            words = f"tolerance is {shown(self.tolerance)}; it has to be 0 to 255, in 1/255"
            raise UsageError(words, field="tolerance")
        if self.view is not None:
            degrees_of(self.view)


VIEWS = {"front": 0.0, "three-quarter": 35.0, "left": 90.0, "right": -90.0, "back": 180.0}
"""Azimuth of the camera in degrees, positive towards the subject's left."""


def degrees_of(view: str) -> float:
    """Azimuth of a named view, or of one in degrees as text.

    Raises:
        UsageError: it is neither.
    """
    try:
        degrees = VIEWS[view] if view in VIEWS else float(view)
    except ValueError:
        degrees = float("nan")
    if not -360.0 <= degrees <= 360.0:
        words = f"view is {shown(view)}; it has to be {', '.join(VIEWS)}, or degrees from -360 to 360"
        raise UsageError(words, field="view")
    return degrees


_KINDS: dict[str, tuple[type, ...]] = {
    "view": (str, int, float),
    "background": (str,),
    "samples": (int,),
    "tolerance": (int, float),
}

FIELDS = tuple(field.name for field in fields(RenderRequest))


def parse_request(values: Mapping[str, Any]) -> RenderRequest:
    """A request of JSON values; missing or null ones have their defaults.

    Raises:
        UsageError: an unknown field, or a value of the wrong type or out of range; names the field.
    """
    unknown = sorted(set(values) - set(FIELDS))
    if unknown:
        raise UsageError(f"there is no field {unknown[0][:40]!r}; there are {', '.join(FIELDS)}", field=unknown[0][:40])
    given = {name: value for name, value in values.items() if value is not None}
    if "scene" in given:
        from service.light.environment import check_name  # loads the shipped images

        try:
            given["scene"] = scene = Scene.from_json(json.dumps(given["scene"]))
            check_name(scene.environment)
        except UsageError as fault:
            raise UsageError(fault.message, field=f"scene/{fault.extra.get('field', '')}".rstrip("/")) from fault
    if "size" in given:
        given["size"] = _size(given["size"])
    for name, kinds in _KINDS.items():
        if name in given and (isinstance(given[name], bool) or not isinstance(given[name], kinds)):
            raise UsageError(f"{name} is {shown(given[name])}, which is of the wrong type", field=name)
    if "view" in given:
        given["view"] = str(given["view"])
    return RenderRequest(**given)


def _size(value: Any) -> tuple[int, int]:
    whole = isinstance(value, list) and all(isinstance(side, int) and not isinstance(side, bool) for side in value)
    if not whole or len(value) != 2:
        raise UsageError(f"size is {shown(value)}; it has to be two whole numbers, [width, height]", field="size")
    return value[0], value[1]
