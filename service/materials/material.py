"""What a surface looks like, said once; OBJ, glTF, USD and the previews are written from this.

The model is that of glTF and UsdPreviewSurface: a diffuse base under one GGX lobe whose reflectance at normal
incidence is :attr:`Material.f0`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from service.arrays import UInt8
from service.errors import NumericFault

Triple = tuple[float, float, float]
Alpha = Literal["opaque", "mask", "blend"]

WHITE: Triple = (1.0, 1.0, 1.0)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
"""Names of materials, parts and their textures: they become names of files and of things in three formats."""


def checked_name(name: str, what: str) -> str:
    """The name, if it can stand in a path and in every format; NumericFault where it cannot."""
    if not NAME.fullmatch(name):
        raise NumericFault(f"{what} is named {name!r}; a letter and up to 39 letters, digits and _ are right")
    return name


@dataclass(frozen=True)
class ChartMap:
    """A map on the head's chart: its name in the archive; without "diffuse_albedo" writers take "texture" for it."""

    role: str


@dataclass(frozen=True, eq=False)
class OwnMap:
    """A texture of a part's own, which becomes ``maps/parts/NAME.png``; equal only to itself.

    Attributes:
        name: of the file.
        pixels: (h, w) or (h, w, 3) or (h, w, 4) uint8, row 0 at v = 1. Colours are sRGB, with straight alpha in the
            fourth channel; roughness, specular and displacement are linear; normals are coded 128 + 127 n.
    """

    name: str
    pixels: UInt8

    def __post_init__(self) -> None:
        checked_name(self.name, "a texture")
        if self.pixels.dtype.name != "uint8" or self.pixels.ndim not in (2, 3) or self.pixels.shape[2:] not in (
            (), (3,), (4,),
        ):  # fmt: skip
            raise NumericFault(
                f"the texture {self.name} is {self.pixels.dtype} of shape {self.pixels.shape}; uint8 of shape (h, w), "
                "(h, w, 3) or (h, w, 4) is right"
            )

    @property
    def has_alpha(self) -> bool:
        """Whether there is a fourth channel."""
        return self.pixels.ndim == 3 and self.pixels.shape[2] == 4


Map = ChartMap | OwnMap


@dataclass(frozen=True)
class Material:
    """Surface of a part. ``opacity`` multiplies the map; ``colour``, ``roughness`` and ``specular`` hold without one.

    A factor on a map of colours is refused: readers of MTL take the map alone, so that one head would have two looks.

    Attributes:
        name: of the material in every format; two materials of an avatar never share one.
        colour: linear RGB in [0, 1]; white where there is a map.
        colour_map: sRGB; its alpha, if it has one, is the part's.
        opacity: factor of alpha; parts of 0 are left out of GLB and previews, and invisible in OBJ and USD.
        alpha: "opaque" ignores alpha, "mask" cuts off below ``cutoff``, "blend" mixes.
        cutoff: in [0, 1].
        double_sided: no backface culling.
        roughness: GGX alpha's square root, in [0, 1].
        roughness_map: linear, in [0, 1].
        ior: index of refraction, >= 1.
        specular: share of the F0 that ``ior`` gives, in [0, 1].
        specular_map: linear, in [0, 1].
        normal_map: tangent space, +Y up.
        displacement_map: heights along the normal.
        cavity_map: linear, share of the sky that the relief leaves open, in [0, 1].
        thickness_map: linear, way of light through the flesh.
        subsurface_mm: mean free path of red, green and blue in the material, millimetres; 0 where light does not enter.
        anisotropy: strength in [0, 1], as glTF has it: how much wider a highlight is across the strands of hair, which
            run along v, than along them; 0 on everything else.
        anisotropy_map: linear, direction across the strands in red and green as 127.5 (1 + d), strength in blue.
        strand_map: linear: place from root to tip, identity and depth of the strand that a texel shows.
    """

    name: str
    colour: Triple = WHITE
    colour_map: Map | None = None
    opacity: float = 1.0
    alpha: Alpha = "opaque"
    cutoff: float = 0.5
    double_sided: bool = False
    roughness: float = 0.5
    roughness_map: Map | None = None
    ior: float = 1.5
    specular: float = 1.0
    specular_map: Map | None = None
    normal_map: Map | None = None
    displacement_map: Map | None = None
    cavity_map: Map | None = None
    thickness_map: Map | None = None
    subsurface_mm: Triple = (0.0, 0.0, 0.0)
    anisotropy: float = 0.0
    anisotropy_map: Map | None = None
    strand_map: Map | None = None

    def __post_init__(self) -> None:
        checked_name(self.name, "a material")
        ranges = {
            "opacity": self.opacity, "cutoff": self.cutoff, "roughness": self.roughness, "specular": self.specular,
            "anisotropy": self.anisotropy,
            **dict(zip(("red", "green", "blue"), self.colour, strict=True)),
        }  # fmt: skip
        for what, value in ranges.items():
            if not 0.0 <= value <= 1.0:
                raise NumericFault(f"{what} of the material {self.name} is {value}; 0 to 1 is right")
        if self.colour_map is not None and self.colour != WHITE:
            raise NumericFault(f"the material {self.name} has a map and a colour, {self.colour}; one is right")
        if not 1.0 <= self.ior <= 4.0:
            raise NumericFault(f"the index of refraction of {self.name} is {self.ior}; 1 to 4 is right")
        if not all(0.0 <= value <= 100.0 for value in self.subsurface_mm):
            raise NumericFault(f"subsurface_mm of {self.name} is {self.subsurface_mm}; 0 to 100 is right")

    @property
    def f0(self) -> float:
        """Reflectance at normal incidence, without the map: specular ((ior - 1) / (ior + 1))^2."""
        return self.specular * ((self.ior - 1.0) / (self.ior + 1.0)) ** 2

    @property
    def textured(self) -> bool:
        """Whether its colour is on the head's chart."""
        return isinstance(self.colour_map, ChartMap)

    @property
    def detailed(self) -> bool:
        """Whether its normals are on the head's chart."""
        return isinstance(self.normal_map, ChartMap)

    @property
    def maps(self) -> tuple[Map, ...]:
        """Its maps, each once."""
        return tuple(dict.fromkeys(self.slots.values()))

    @property
    def slots(self) -> dict[str, Map]:
        """Its maps by what they are for: "colour", "roughness" and the like."""
        named = {name.removesuffix("_map"): getattr(self, name) for name in vars(self) if name.endswith("_map")}
        return {slot: one for slot, one in named.items() if one is not None}
