"""Which maps there are, how each is coded, and their PNG bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy.typing as npt

from service.archive.images import NORMAL_SCALE, NORMAL_ZERO, encode_normals8, encode_png
from service.texture.result import MIRRORED, SEEN, Texture


@dataclass(frozen=True)
class MapSpec:
    """One map of the archive.

    Attributes:
        role: its name in options and manifest.
        colour_space: "srgb", "linear" or "data" (vectors).
        frame: of normals, else None.
        zero, scale: value = (code - zero) / scale.
        meaning: of the value.
        codes: takes the maps, gives (h, w) or (h, w, 3) uint8 codes.
    """

    role: str
    colour_space: Literal["srgb", "linear", "data"]
    frame: Literal["object", "tangent"] | None
    zero: float
    scale: float
    meaning: str
    codes: Callable[[Texture], npt.NDArray[Any]]

    @property
    def path(self) -> str:
        """Name in the archive."""
        return f"maps/{self.role}.png"


MAPS = (
    MapSpec(
        "texture", "srgb", None, 0, 255, "colour in the photo's light, sRGB coded, in [0, 1]", lambda maps: maps.texture
    ),
    MapSpec(
        "confidence", "linear", None, 0, 255,
        f"codes 255 to {SEEN}: seen in the photo, by weight; {SEEN - 1} to {MIRRORED}: mirrored from the other side; "
        f"0: made up",
        lambda maps: maps.confidence,
    ),
    MapSpec(
        "shape_normal", "data", "object", NORMAL_ZERO, NORMAL_SCALE,
        "unit normal of mesh/head.obj: R = +X, the subject's left; G = +Y, up; B = +Z, out of the face",
        lambda maps: encode_normals8(maps.shape_normal_object),
    ),
)  # fmt: skip
"""Maps of this version, in the order of the archive."""


def encode_map(spec: MapSpec, maps: Texture) -> bytes:
    """PNG bytes of one map; NumericFault where normals are not finite."""
    return encode_png(spec.codes(maps), srgb=spec.colour_space == "srgb")
