"""Materials of the head model's own parts."""

from __future__ import annotations

from service.materials.material import ChartMap, Material

COLOUR = ChartMap("diffuse_albedo")
"""Colours of the chart: the diffuse albedo, or the texture where there is none."""

SKIN = Material(
    "skin",
    colour_map=COLOUR,
    roughness=0.55,
    specular_map=ChartMap("specular_albedo"),
    normal_map=ChartMap("specular_normal"),
)
_BY_PREFIX = {
    "skin": SKIN,
    "eye": Material("eye", colour_map=COLOUR, roughness=0.1),
    "teeth": Material("teeth", colour_map=COLOUR, roughness=0.25),
    "tongue": Material("tongue", colour_map=COLOUR, roughness=0.35),
    # Cards without an alpha cut-out look like a mask; the texture shows the photo's lashes on the lids.
    "lashes": Material("lashes", (0.012, 0.009, 0.007), roughness=0.7, opacity=0.0, double_sided=True),
}


def material_of(part: str) -> Material:
    """Material of a head's part by the first word of its name; unknown parts (of an imported head) are skin."""
    return _BY_PREFIX.get(part.split("_")[0], SKIN)
