"""``mesh/head.mtl``: the materials of ``head.obj``, with the PBR keys that importers of Blender, Maya and others read.

Blender reads ``Ks`` as its specular level (0.5 is the F0 that ``Ni`` gives), ``Pr`` as roughness, and a normal map only
as ``map_Bump -bm 1``; ``norm`` is for others. It takes every texture of an MTL file for sRGB but EXR, so all that are
no colours come as EXR (:func:`data_maps`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from service.archive.exr import exr_bytes
from service.archive.images import decode_normals8
from service.archive.map_files import MapFiles
from service.arrays import Float32, UInt8
from service.materials.material import ChartMap, Map, Material, OwnMap

LEVEL = 0.5
"""Specular level of ``Ks`` that stands for the whole F0 of the index of refraction."""


def mtl_bytes(materials: Iterable[Material], files: MapFiles) -> bytes:
    """MTL text of materials, each once by name, in order of appearance."""
    distinct = {material.name: material for material in materials}
    return "\n".join(_material(material, files) for material in distinct.values()).encode("ascii")


def _material(material: Material, files: MapFiles) -> str:
    red, green, blue = material.colour
    # Phong exponent whose lobe is about as wide as that of GGX with alpha = roughness^2.
    exponent = 2.0 / max(material.roughness, 0.05) ** 4 - 2.0
    level = LEVEL * material.specular
    lines = [
        f"newmtl {material.name}",
        "Ka 0 0 0",
        f"Kd {red:g} {green:g} {blue:g}",
        f"Ks {level:g} {level:g} {level:g}",
        f"Ns {min(exponent, 1000.0):.1f}",
        f"Ni {material.ior:g}",
        f"d {material.opacity * (1 - material.transmission):g}",
        "illum 2",
        f"Pr {material.roughness:g}",
    ]
    colour = files.path(material.colour_map)
    maps = {
        "map_Kd": colour, "map_d": colour if material.alpha != "opaque" else None,
        "map_Ks": data_path(material.specular_map, files), "map_Pr": data_path(material.roughness_map, files),
        "map_Bump -bm 1": data_path(material.normal_map, files), "norm": data_path(material.normal_map, files),
    }  # fmt: skip
    lines += [f"{key} {path}" for key, path in maps.items() if path is not None]
    return "\n".join(lines) + "\n"


def data_path(one: Map | None, files: MapFiles) -> str | None:
    """Path of the EXR of a map, as seen from the mesh; None where there is none."""
    if one is None or files.path(one) is None:
        return None
    return f"{one.role}.exr" if isinstance(one, ChartMap) else f"../maps/parts/{one.name}.exr"


def data_maps(
    materials: Iterable[Material], files: MapFiles, charts: Mapping[str, Float32]
) -> dict[str, bytes]:
    """Name in the archive -> EXR of every map that is no colour.

    Args:
        materials: of the MTL file.
        files: which maps the archive has.
        charts: of the chart, by role: normals (h, w, 3) in [-1, 1], the others (h, w) in [0, 1].
    """
    made: dict[str, bytes] = {}
    for material in materials:
        for slot, one in (
            ("specular", material.specular_map), ("roughness", material.roughness_map), ("normal", material.normal_map),
        ):  # fmt: skip
            path = data_path(one, files)
            name = None if path is None else path.removeprefix("../") if path.startswith("../") else f"mesh/{path}"
            if name is None or name in made:
                continue
            values = _own(one, slot) if isinstance(one, OwnMap) else charts[one.role] if one is not None else None
            if values is not None:
                made[name] = exr_bytes(_coded(values, slot))
    return made


def _own(one: OwnMap, slot: str) -> Float32:
    pixels: UInt8 = one.pixels
    if slot == "normal":
        return decode_normals8(pixels[..., :3])
    return np.asarray((pixels if pixels.ndim == 2 else pixels[..., 0]) / np.float32(255), np.float32)


def _coded(values: Float32, slot: str) -> Float32:
    """Normals as 0.5 + 0.5 n, specular as a level, roughness as it is, in steps of 1/256, which compress well."""
    factor, shift = {"normal": (0.5, 0.5), "specular": (LEVEL, 0.0), "roughness": (1.0, 0.0)}[slot]
    codes = np.rint(values * np.float32(256 * factor) + np.float32(256 * shift))
    return np.asarray(codes / np.float32(256), np.float32)
