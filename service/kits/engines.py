"""Kits for Unreal, Unity and Maya: levels of detail as GLB, and the maps in the packing that each wants."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from service.archive.container import ArchiveFile
from service.archive.glb import Picture, chart_textures, glb_bytes
from service.archive.images import NORMAL_SCALE, NORMAL_ZERO, encode_png
from service.archive.reading import unpack_map
from service.arrays import UInt8
from service.kits.lod import levels_of_detail, triangles
from service.kits.source import extract, kit_facts, materials_of, read_parts, write, write_light

LARGEST = 4096
IN_GLB = 2048
"""Largest sides of textures as files, and in the GLBs."""


@dataclass
class Charts:
    """Maps of the chart of an archive, decoded when they are needed, square: engines want powers of two.

    Attributes:
        source: the archive.
        largest: side of the textures at most; less where the maps are smaller.
    """

    source: ArchiveFile
    largest: int = LARGEST
    _read: dict[str, UInt8] = field(default_factory=dict)

    def has(self, role: str) -> bool:
        """Whether there is such a map."""
        return f"maps/{role}.png" in self.source.names

    def codes(self, role: str) -> UInt8:
        """(n, n, 3) uint8 codes, n a power of two: the height of the map, or the next lower one."""
        if role not in self._read:
            self._read[role] = _square(unpack_map(self.source.read(f"maps/{role}.png"), role), self.largest)
        return self._read[role]

    @property
    def colour(self) -> str:
        """Role of the colours."""
        return "diffuse_albedo" if self.has("diffuse_albedo") else "texture"

    def normal(self, *, up: bool) -> UInt8:
        """Specular normals as 127.5 (1 + n), green up as in OpenGL, or down as in DirectX."""
        vectors = (self.codes("specular_normal").astype(np.float32) - NORMAL_ZERO) / np.float32(NORMAL_SCALE)
        if not up:
            vectors[..., 1] *= -1
        length = np.sqrt(np.maximum(np.einsum("hwc,hwc->hw", vectors, vectors), 1e-6))[..., None]
        return np.asarray(np.rint(127.5 * (1 + vectors / length)).clip(0, 255), np.uint8)

    def packed(self, channels: Mapping[str, float | Callable[[UInt8], UInt8]], order: tuple[str | int, ...]) -> UInt8:
        """Channels of several maps in one picture.

        Args:
            channels: role -> what is done to its codes, or the value in [0, 1] where there is no such map.
            order: of each channel of the result a role, or a code.
        """
        side = next((self.codes(role).shape[0] for role in order if isinstance(role, str) and self.has(role)), 1)
        planes = []
        for role in order:
            if isinstance(role, int):
                planes.append(np.full((side, side), role, np.uint8))
                continue
            value = channels.get(role, 1.0)
            if self.has(role):
                codes = _square(self.codes(role), side)[..., 0]
                planes.append(value(codes) if callable(value) else codes)
            else:
                constant = value if isinstance(value, float) else 1.0
                planes.append(np.full((side, side), round(255 * constant), np.uint8))
        return np.stack(planes, -1)


def glb_charts(charts: Charts) -> dict[str, Picture]:
    """Textures of the chart for ``service.archive.glb``, no larger than ``IN_GLB``, by role."""
    small = Charts(charts.source, IN_GLB, {role: _square(codes, IN_GLB) for role, codes in charts._read.items()})
    plain = {
        slot: small.codes(role)[..., 0] if small.has(role) else None
        for slot, role in (("specular", "specular_albedo"), ("roughness", "roughness"), ("cavity", "cavity"))
    }
    normal = small.normal(up=True) if small.has("specular_normal") else None
    return chart_textures(small.codes(small.colour), normal, **plain)


def half(codes: UInt8) -> UInt8:
    """Codes of half the value: Unreal's Specular of 0.5 is F0 = 0.04."""
    return np.asarray((codes.astype(np.uint16) + 1) // 2, np.uint8)


def inverted(codes: UInt8) -> UInt8:
    """255 - code: smoothness of roughness."""
    return np.asarray(255 - codes, np.uint8)


def _square(codes: UInt8, largest: int) -> UInt8:
    import cv2

    side = min(1 << (codes.shape[0].bit_length() - 1), largest)
    if codes.shape[:2] == (side, side):
        return codes
    way = cv2.INTER_AREA if codes.shape[0] > side or codes.shape[1] > side else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(codes, (side, side), interpolation=way))


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


def write_engine_kit(source: ArchiveFile, folder: Path, tool: str) -> list[Path]:
    """Levels of detail, textures, the environment, and ``kit.json``, which says what is what.

    Raises:
        BadArchive: the archive cannot be used.
        OutputFault: a file could not be written.
    """
    charts = Charts(source)
    more = ("mesh/head.usda", "mesh/head.mtlx", "maps/") if tool == "maya" else ()
    always = ("LICENSES.md", "maps/displacement.png", "maps/wrinkle_", "mesh/hair.usda")
    written = extract(source, folder, (*always, *more))
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
    pictures, head = glb_charts(charts), source.manifest["head"]
    facts = kit_facts(source)
    levels = []
    for number, level in enumerate(levels_of_detail(parts)):
        path = folder / f"head_lod{number}.glb"
        data = glb_bytes(
            level, pictures, units=facts["units"], expression=facts["expression"], head=head["name"],
            licence=head["licence"],
        )  # fmt: skip
        write(path, data)
        written.append(path)
        levels.append({"file": path.name, "triangles": sum(map(triangles, level))})
    written += write_light(source, folder)
    facts = {"tool": tool, "levels": levels, "textures": textures, **facts}
    write(folder / "kit.json", (json.dumps(facts, indent=1) + "\n").encode())
    return [*written, folder / "kit.json"]
