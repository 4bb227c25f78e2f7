"""What was found out about the photo's own detail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Octave:
    """What of an octave is the photo's.

    Attributes:
        shortest_mm, longest_mm: periods on the face.
        share: what the photo tells of the octave on skin that it shows, mean by area, in [0, 1]; the rest is made up.
    """

    shortest_mm: float
    longest_mm: float
    share: float


@dataclass(frozen=True)
class Detail:
    """A photo's detail on a map.

    Attributes:
        octaves: of the map, finest first.
        blur_px: standard deviation of the photo's point spread function at the face, pixels.
        noise: standard deviation of the photo's noise, sRGB-coded luma, 1 = white.
        pixels_per_mm: of the photo on the surface of regions that it shows, median.
    """

    octaves: tuple[Octave, ...]
    blur_px: float
    noise: float
    pixels_per_mm: Mapping[str, float]
