"""``mesh/head.mtl``: the materials of ``head.obj``, with the PBR keys that Blender, Maya's and others' importers read.

Blender reads ``Ks`` as its specular level (0.5 is F0 = 0.04), ``Pr`` as roughness, and a normal map only as
``map_Bump -bm 1``; it ignores ``norm``.
"""

from __future__ import annotations

from collections.abc import Iterable

from service.archive.map_files import MapFiles
from service.materials.material import Material


def mtl_bytes(materials: Iterable[Material], files: MapFiles) -> bytes:
    """MTL text of materials, each once by name, in order of appearance."""
    distinct = {material.name: material for material in materials}
    return "\n".join(_material(material, files) for material in distinct.values()).encode("ascii")


def _material(material: Material, files: MapFiles) -> str:
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
    colour, normal = files.path(material.colour_map), files.path(material.normal_map)
    if colour is not None:
        lines.append(f"map_Kd {colour}")
    if normal is not None:
        lines.append(f"norm {normal}")
    return "\n".join(lines) + "\n"
