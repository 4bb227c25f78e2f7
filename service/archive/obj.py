"""``mesh/head.obj`` and ``head.mtl``: the head with the photo's expression.

Metres, +Y up, +Z out of the face, unposed (the camera holds the pose). The original polygons, a ``vt`` per chart
vertex with its origin bottom left, one object, group and material per part. OBJ has no unit, so the header names it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from service.archive.surface import vertex_normals
from service.arrays import AnyFloat, Int32
from service.errors import NumericFault
from service.head.model import HeadModel
from service.materials.material import Material
from service.materials.of_head import material_of

TEXTURE_FROM_MESH = "../maps/texture.png"

_HEADER = """\
# {title}
# unit: metre; +Y up, +Z out of the face, +X to the subject's left; the photo's expression, without the head's pose
# vt origin: bottom left; {vertices} vertices, {polygons} polygons
mtllib head.mtl
"""


def obj_bytes(head: HeadModel, vertices: AnyFloat, title: str) -> bytes:
    """OBJ text of ``vertices`` (V, 3) metres with the topology of ``head``, to the micrometre.

    Vertex order is the head model's, so the same line of two archives is the same point of two heads.

    Raises:
        NumericFault: a vertex is not finite.
    """
    if not np.isfinite(vertices).all():
        raise NumericFault(f"vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])} of the head is not finite")
    normals = vertex_normals(vertices, head.triangles)
    header = _HEADER.format(title=title, vertices=len(vertices), polygons=len(head.polygons))
    blocks = [header, _lines("v %.6f %.6f %.6f\n", vertices), _lines("vt %.6f %.6f\n", head.uv)]
    blocks += [_lines("vn %.4f %.4f %.4f\n", normals), *_parts(head)]
    return "".join(blocks).encode("ascii")


def mtl_bytes(
    head: HeadModel, *, textured: bool = True, texture: str = TEXTURE_FROM_MESH, normal: str | None = None
) -> bytes:
    """Materials of the parts.

    Args:
        head: the head model.
        textured: False where the archive has no ``texture``.
        texture: relative path of the colours.
        normal: relative path of tangent-space normals for the skin (``norm``, of the PBR extension to MTL).
    """
    used = {material_of(name).name: material_of(name) for name in head.part_names}
    files = (texture if textured else None, normal)
    return "\n".join(_material(material, *files) for material in used.values()).encode("ascii")


def _lines(pattern: str, rows: AnyFloat) -> str:
    values = np.asarray(rows, np.float64) + 0.0  # -0.0 becomes 0.0
    return (pattern * len(values)) % tuple(values.ravel().tolist())


def _parts(head: HeadModel) -> Iterator[str]:
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if chosen.any():
            yield f"o {name}\ng {name}\nusemtl {material_of(name).name}\ns 1\n"
            yield from _faces(head.polygons[chosen], head.polygon_uv[chosen])


def _faces(polygons: Int32, uv: Int32) -> Iterator[str]:
    """Lines ``f v/vt/vn ...``, in the order of the model; a vertex and its normal have the same index."""
    corners = np.stack([polygons, uv, polygons], 2).astype(np.int64) + 1
    quad = "f %d/%d/%d %d/%d/%d %d/%d/%d %d/%d/%d\n"
    triangle = "f %d/%d/%d %d/%d/%d %d/%d/%d\n"
    is_triangle = polygons[:, 3] < 0
    patterns = np.where(is_triangle, triangle, quad)
    present = np.repeat(polygons >= 0, 3, axis=1)
    yield "".join(patterns.tolist()) % tuple(corners.reshape(len(polygons), -1)[present].tolist())


def _material(material: Material, texture: str | None, normal: str | None) -> str:
    red, green, blue = material.colour
    # Phong exponent whose lobe is about as wide as that of GGX with alpha = roughness^2.
    exponent = 2.0 / max(material.roughness, 0.05) ** 4 - 2.0
    lines = [
        f"newmtl {material.name}",
        "Ka 0 0 0",
        f"Kd {red:g} {green:g} {blue:g}",
        "Ks 0.04 0.04 0.04",
        f"Ns {min(exponent, 1000.0):.1f}",
        f"d {material.opacity:g}",
        "illum 2",
    ]
    if texture is not None and material.textured:
        lines.append(f"map_Kd {texture}")
    if normal is not None and material.detailed:
        lines.append(f"norm {normal}")
    return "\n".join(lines) + "\n"
