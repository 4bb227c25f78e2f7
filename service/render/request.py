"""Options of a render, checked before any work starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
            raise UsageError(
                f"size is {width}x{height}; each side has to be {SMALLEST_SIDE} to {LARGEST_SIDE} pixels", field="size"
            )
        if self.background not in BACKGROUNDS:
            raise UsageError(
                f"background is {self.background!r}; it has to be one of {', '.join(BACKGROUNDS)}", field="background"
            )
        if self.samples not in range(1, FINEST + 1):
            raise UsageError(
                f"samples is {self.samples!r}; it has to be 1 to {FINEST} per pixel and axis", field="samples"
            )
        if width * height * self.samples**2 > LARGEST_PIXELS:
            raise UsageError(
                f"size {width}x{height} with {self.samples}x{self.samples} samples per pixel is {width * height} x "
                f"{self.samples**2} samples; at most {LARGEST_PIXELS} are computed",
                field="size",
            )
        if not 0.0 <= self.tolerance <= 255.0:
            raise UsageError(f"tolerance is {self.tolerance!r}; it has to be 0 to 255, in 1/255", field="tolerance")
