"""Options of a render, from code or from untrusted JSON, checked before any work starts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le
from pydantic import AfterValidator, AllowInfNan, BeforeValidator, Strict
from pydantic.dataclasses import dataclass

from service.checks import CHECKED, Checked, Right, shown
from service.errors import UsageError
from service.light.scene import Environment, Response, Scene

SMALLEST_SIDE, LARGEST_SIDE = 16, 4096
LARGEST_PIXELS = 4096 * 4096
FINEST = 3
"""Most samples per pixel and axis."""

STUDIO = Scene(Environment(name="studio"), response=Response(target=0.7, shoulder=0.6))
"""The default scene. Its highlights roll off: the shoulders are nearer to its lamps than the face."""

VIEWS = {"front": 0.0, "three-quarter": 35.0, "left": 90.0, "right": -90.0, "back": 180.0}
"""Azimuth of the camera in degrees, positive towards the subject's left."""


def degrees_of(view: str) -> float:
    """Azimuth of a named view, or of one in degrees as text; UsageError where it is neither."""
    try:
        degrees = VIEWS[view] if view in VIEWS else float(view)
    except ValueError:
        degrees = float("nan")
    if not -360.0 <= degrees <= 360.0:
        words = f"view is {shown(view)}; it has to be {', '.join(VIEWS)}, or degrees from -360 to 360"
        raise UsageError(words, field="view")
    return degrees


def _as_text(view: object) -> object:
    return str(view) if isinstance(view, int | float) and not isinstance(view, bool) else view


def _known_view(view: str | None) -> str | None:
    if view is not None:
        degrees_of(view)
    return view


_Side = Annotated[int, Strict(), Ge(SMALLEST_SIDE), Le(LARGEST_SIDE)]


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class RenderRequest(Checked):
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
    size: Annotated[
        tuple[_Side, _Side], Right(f"two whole numbers, [width, height], each {SMALLEST_SIDE} to {LARGEST_SIDE}")
    ] = (768, 1024)
    view: Annotated[
        str | None, BeforeValidator(_as_text), AfterValidator(_known_view), Right(f"{', '.join(VIEWS)}, or degrees")
    ] = None
    background: Literal["black", "transparent", "environment"] = "black"
    samples: Annotated[int, Strict(), Ge(1), Le(FINEST), Right(f"1 to {FINEST} per pixel and axis")] = 2
    tolerance: Annotated[
        float, Strict(), Ge(0), Le(255), AllowInfNan(False), Right("a number from 0 to 255, in 1/255")
    ] = 1.0

    def __post_init__(self) -> None:
        """Check the number of samples, and that there is light."""
        if self.scene.dark():
            words = "the scene has no light, so the picture would be black; give it an 'environment' or 'lights'"
            raise UsageError(words, field="scene")
        width, height = self.size
        if width * height * self.samples**2 > LARGEST_PIXELS:
            raise UsageError(
                f"size {width}x{height} with {self.samples}x{self.samples} samples per pixel is {width * height} x "
                f"{self.samples**2} samples; at most {LARGEST_PIXELS} are computed",
                field="size",
            )


def parse_request(values: Mapping[str, Any]) -> RenderRequest:
    """A request of JSON values; missing or null ones have their defaults.

    UsageError: an unknown field, or a value of the wrong type or out of range; names the field.
    """
    from service.light.environment import check_name  # loads the shipped images

    request = RenderRequest(**{name: value for name, value in values.items() if value is not None})
    try:
        check_name(request.scene.environment)
    except UsageError as fault:
        raise UsageError(fault.message, field=f"scene/{fault.extra['field']}") from fault
    return request
