"""Materials of the head's parts, shared by OBJ, glTF and USD."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """Surface of a part.

    Attributes:
        name: of the material in every format.
        colour: linear RGB in [0, 1]; multiplies the texture where there is one.
        roughness: GGX alpha's square root, in [0, 1].
        textured: colour from the chart.
        detailed: normals and specular albedo from the chart, too.
        opacity: 1 is opaque; parts of 0 are left out of GLB and previews, and invisible in OBJ and USD.
        double_sided: no backface culling.
    """

    name: str
    colour: tuple[float, float, float]
    roughness: float
    textured: bool = False
    detailed: bool = False
    opacity: float = 1.0
    double_sided: bool = False


_SKIN = Material("skin", (1.0, 1.0, 1.0), 0.55, textured=True, detailed=True)
_BY_PREFIX = {
    "skin": _SKIN,
    "eye": Material("eye", (1.0, 1.0, 1.0), 0.1, textured=True),
    "teeth": Material("teeth", (1.0, 1.0, 1.0), 0.25, textured=True),
    "tongue": Material("tongue", (1.0, 1.0, 1.0), 0.35, textured=True),
    # Cards without an alpha cut-out look like a mask; the texture shows the photo's lashes on the lids.
    "lashes": Material("lashes", (0.012, 0.009, 0.007), 0.7, opacity=0.0, double_sided=True),
}


def material_of(part: str) -> Material:
    """Material of a part by the first word of its name; unknown parts (of an imported head) are skin."""
    return _BY_PREFIX.get(part.split("_")[0], _SKIN)
