"""Kits for Unreal, Unity and Maya: levels of detail as GLB, and the maps in the packing that each wants."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.archive.glb import glb_bytes
from service.archive.images import encode_png
from service.archive.licences import COPYRIGHT
from service.archive.version import GENERATOR
from service.arrays import UInt8
from service.kits.light import environment
from service.kits.lod import levels_of_detail, triangles
from service.kits.materials import materials_of
from service.kits.read_usd import read_parts
from service.kits.textures import Charts, glb_charts, half, inverted
from service.kits.unpacked import Source, write


@dataclass(frozen=True)
class Packed:
    """One texture of a kit.

    Attributes:
        name: of the file, without extension.
        needs: roles of which the archive must have at least one.
        make: charts -> picture.
        srgb: whether the engine's sRGB flag has to be set.
        use: what it is for, in the engine's words.
    """

    name: str
    needs: tuple[str, ...]
    make: Callable[[Charts], UInt8]
    srgb: bool
    use: str


_COLOUR = Packed(
    "head_basecolor", ("diffuse_albedo", "texture"), lambda charts: charts.codes(charts.colour), True, "base colour"
)
_THICKNESS = Packed(
    "head_thickness", ("thickness",), lambda charts: charts.codes("thickness")[..., 0], False,
    "thickness of the flesh, 1 = 25.5 mm or more",
)  # fmt: skip


def _normal(up: bool, use: str) -> Packed:
    name = f"head_normal_{'opengl' if up else 'directx'}"
    return Packed(name, ("specular_normal",), lambda charts: charts.normal(up=up), False, use)


PACKING: dict[str, tuple[Packed, ...]] = {
    "unreal": (
        _COLOUR,
        _normal(False, "Normal, compression Normalmap; green points down, so Flip Green Channel stays off"),
        Packed(
            "head_orm", ("roughness", "cavity"),
            lambda charts: charts.packed({"roughness": 0.55}, ("cavity", "roughness", 0)), False,
            "Masks: R ambient occlusion, G roughness, B metallic",
        ),
        Packed(
            "head_specular", ("specular_albedo",),
            lambda charts: charts.packed({"specular_albedo": half}, ("specular_albedo",) * 3), False,
            "Specular: 0.5 is F0 = 0.04",
        ),
        _THICKNESS,
    ),
    "unity": (
        _COLOUR,
        _normal(True, "Normal map; green points up"),
        Packed(
            "head_mask", ("roughness", "cavity"),
            lambda charts: charts.packed({"roughness": inverted}, (0, "cavity", 255, "roughness")), False,
            "HDRP mask map: R metallic, G ambient occlusion, B detail mask, A smoothness",
        ),
        Packed(
            "head_specular", ("specular_albedo",), lambda charts: charts.packed({}, ("specular_albedo",) * 3), False,
            "share of F0 = 0.04",
        ),
        _THICKNESS,
    ),
    "maya": (
        _COLOUR,
        _normal(True, "aiNormalMap or bump2d in Tangent Space Normals; green points up"),
        Packed(
            "head_roughness", ("roughness",), lambda charts: charts.codes("roughness")[..., 0], False,
            "specularRoughness, alpha is luminance",
        ),
        Packed(
            "head_specular", ("specular_albedo",), lambda charts: charts.codes("specular_albedo")[..., 0], False,
            "specular weight at IOR 1.5",
        ),
        _THICKNESS,
    ),
}  # fmt: skip
"""Textures of each kit."""


def write_kit(source: Source, folder: Path, tool: str) -> list[Path]:
    """Levels of detail, textures, the environment, and ``kit.json``, which says what is what.

    Raises:
        BadArchive: the archive cannot be used.
        OutputFault: a file could not be written.
    """
    charts = Charts(source)
    more = ("mesh/head.usda", "mesh/head.mtlx", "maps/") if tool == "maya" else ()
    written = source.unpack(folder, ("LICENSES.md", "maps/displacement.png", *more))
    materials = materials_of(source)
    parts = [part for part in read_parts(source.read("mesh/head.usda"), source.manifest, materials)
             if part.material.opacity > 0]  # fmt: skip
    textures = []
    for one in PACKING[tool]:
        if any(charts.has(role) for role in one.needs):
            path = folder / "textures" / f"{one.name}.png"
            write(path, encode_png(one.make(charts), srgb=one.srgb))
            written.append(path)
            textures.append({"file": f"textures/{path.name}", "srgb": one.srgb, "use": one.use})
    pictures = glb_charts(charts)
    levels = []
    for number, level in enumerate(levels_of_detail(parts)):
        path = folder / f"head_lod{number}.glb"
        write(path, _glb(source, level, pictures))
        written.append(path)
        levels.append({"file": path.name, "triangles": sum(map(triangles, level))})
    light = environment(source)
    if light is not None:
        write(folder / "photo_light.exr", light)
        written.append(folder / "photo_light.exr")
    facts = {"tool": tool, "levels": levels, "textures": textures, **_described(source)}
    write(folder / "kit.json", (json.dumps(facts, indent=1) + "\n").encode())
    return [*written, folder / "kit.json"]


def _described(source: Source) -> dict[str, Any]:
    manifest = source.manifest
    return {name: manifest.get(name) for name in ("parts", "materials", "joints", "displacement", "camera")} | {
        "units": manifest["head"]["blendshapes"], "expression": (manifest.get("fit") or {}).get("expression", {}),
    }  # fmt: skip


def _glb(source: Source, parts: Any, pictures: Any) -> bytes:
    manifest = source.manifest
    head = manifest["head"]
    return glb_bytes(
        parts, pictures, units=head["blendshapes"], generator=GENERATOR, copyright_notice=COPYRIGHT,
        expression=(manifest.get("fit") or {}).get("expression", {}),
        extras={"headModel": head["name"], "headModelLicence": head["licence"], "units": "metre"},
    )  # fmt: skip
