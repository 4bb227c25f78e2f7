"""The head model's own parts: their materials, and each as a mesh of its own."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Int32, Int64
from service.head.model import HeadModel
from service.materials.material import ChartMap, Material
from service.materials.part import Bone, MeshPart

COLOUR = ChartMap("diffuse_albedo")
"""Colours of the chart: the diffuse albedo, or the texture where there is none."""

SKIN = Material(
    "skin",
    colour_map=COLOUR,
    roughness=0.55,
    specular=0.65,
    specular_map=ChartMap("specular_albedo"),
    normal_map=ChartMap("specular_normal"),
    roughness_map=ChartMap("roughness"),
    displacement_map=ChartMap("displacement"),
    cavity_map=ChartMap("cavity"),
    thickness_map=ChartMap("thickness"),
    # Diffuse mean free path of skin (Jensen et al. 2001, "skin1": 1 / sigma_tr).
    subsurface_mm=(3.67, 1.37, 0.68),
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


_BONES: dict[str, Bone] = {
    "eye_left": "eye_left", "eye_right": "eye_right", "teeth_lower": "jaw", "tongue": "jaw",
}  # fmt: skip
"""The joint that carries a part; the head carries the others."""


def head_parts(head: HeadModel, vertices: AnyFloat, neutral: AnyFloat) -> list[MeshPart]:
    """The head's own parts that have faces, in the order of ``part_names``, each with its own vertices.

    Args:
        head: topology, chart and blendshapes.
        vertices: (V, 3) metres, the photo's expression.
        neutral: (V, 3) metres.

    Raises:
        NumericFault: a vertex or a blendshape is not finite.
    """
    parts = []
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if not chosen.any():
            continue
        own, faces = _renumbered(head.polygons[chosen])
        places, uv_faces = _renumbered(head.polygon_uv[chosen])
        moved = {unit: head.expression[number, own] for number, unit in enumerate(head.expression_names)}
        parts.append(
            MeshPart(
                name=name,
                vertices=np.asarray(vertices, np.float32)[own],
                neutral=np.asarray(neutral, np.float32)[own],
                faces=faces,
                uv=head.uv[places],
                uv_faces=uv_faces,
                material=material_of(name),
                targets={unit: offsets for unit, offsets in moved.items() if offsets.any()},
                bone=_BONES.get(name, "head"),
            )
        )
    return parts


def _renumbered(polygons: Int32) -> tuple[Int64, Int32]:
    """The indices that polygons (Q, 4) use, ascending, and the polygons as positions among them; -1 stays."""
    used, place = np.unique(polygons[polygons >= 0], return_inverse=True)
    made = np.full(polygons.shape, -1, np.int32)
    made[polygons >= 0] = place
    return used.astype(np.int64), made
