"""Kits for Unreal, Unity and Maya: levels of detail as GLB, and the maps in the packing that each wants."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from service.archive.container import ArchiveFile
from service.archive.glb import chart_textures, glb_bytes
from service.archive.images import NORMAL_SCALE, NORMAL_ZERO, encode_png
from service.archive.reading import unpack_map
from service.archive.surfaces import Piece
from service.arrays import Int64, UInt8
from service.geometry.remesh import Subdivision, collapsed
from service.image_filters import resized
from service.kits.source import extract, kit_facts, materials_of, read_parts, write, write_light
from service.materials.part import MeshPart, part_triangles

LARGEST = 4096
IN_GLB = 2048
"""Largest sides of textures as files, and in the GLBs."""


class Swizzle(NamedTuple):
    """One channel of a texture.

    Attributes:
        role: of its map; "" for none.
        otherwise: code in place of a map that is not there.
        change: what is done to the map's codes.
    """

    role: str
    otherwise: int = 255
    change: Callable[[UInt8], UInt8] | None = None


@dataclass
class KitCharts:
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

    def packed(self, channels: Sequence[Swizzle]) -> UInt8:
        """(n, n, C) or, of one channel, (n, n): channels of several maps in one picture."""
        side = next((self.codes(one.role).shape[0] for one in channels if self.has(one.role)), 1)
        planes = []
        for one in channels:
            codes = np.full((side, side), one.otherwise, np.uint8)
            if self.has(one.role):
                codes = _square(self.codes(one.role), side)[..., 0]
                codes = one.change(codes) if one.change else codes
            planes.append(codes)
        return planes[0] if len(planes) == 1 else np.stack(planes, -1)


def glb_charts(charts: KitCharts) -> dict[str, bytes]:
    """Textures of the chart for ``service.archive.glb``, no larger than ``IN_GLB``, by role."""
    small = KitCharts(charts.source, IN_GLB, {role: _square(codes, IN_GLB) for role, codes in charts._read.items()})
    plain = {
        slot: small.codes(role)[..., 0] if small.has(role) else None
        for slot, role in (("specular", "specular_albedo"), ("roughness", "roughness"), ("cavity", "cavity"))
    }
    normal = small.normal(up=True) if small.has("specular_normal") else None
    return chart_textures(small.codes(small.colour), normal, **plain)


def _square(codes: UInt8, largest: int) -> UInt8:
    side = min(1 << (codes.shape[0].bit_length() - 1), largest)
    if codes.shape[:2] == (side, side):
        return codes
    return resized(codes, (side, side))


@dataclass(frozen=True)
class Packed:
    """One texture of a kit.

    Attributes:
        name: of the file, without extension.
        needs: roles of which the archive must have at least one.
        make: charts -> picture.
        use: what it is for, in the engine's words.
        srgb: whether the engine's sRGB flag has to be set.
    """

    name: str
    needs: tuple[str, ...]
    make: Callable[[KitCharts], UInt8]
    use: str
    srgb: bool = False


def _of(name: str, use: str, *channels: Swizzle) -> Packed:
    roles = tuple(one.role for one in channels if one.role)
    return Packed(f"head_{name}", roles, lambda charts: charts.packed(channels), use)


def _normal(use: str, *, up: bool) -> Packed:
    name = f"head_normal_{'opengl' if up else 'directx'}"
    return Packed(name, ("specular_normal",), lambda charts: charts.normal(up=up), use)


def _half(codes: UInt8) -> UInt8:
    return np.asarray((codes.astype(np.uint16) + 1) // 2, np.uint8)


_COLOUR = Packed(
    "head_basecolor", ("diffuse_albedo", "texture"), lambda charts: charts.codes(charts.colour), "base colour", True
)
_THICKNESS = _of("thickness", "thickness of the flesh, 1 = 25.5 mm or more", Swizzle("thickness"))
_CAVITY, _ROUGHNESS, _SPECULAR = Swizzle("cavity"), Swizzle("roughness", 140), Swizzle("specular_albedo")

PACKING: dict[str, tuple[Packed, ...]] = {
    "unreal": (
        _COLOUR,
        _normal("Normal, compression Normalmap; green points down, so Flip Green Channel stays off", up=False),
        _of("orm", "Masks: R ambient occlusion, G roughness, B metallic", _CAVITY, _ROUGHNESS, Swizzle("", 0)),
        _of("specular", "Specular: 0.5 is F0 = 0.04", *[Swizzle("specular_albedo", change=_half)] * 3),
        _THICKNESS,
    ),
    "unity": (
        _COLOUR,
        _normal("Normal map; green points up", up=True),
        _of(
            "mask", "HDRP mask map: R metallic, G ambient occlusion, B detail mask, A smoothness",
            Swizzle("", 0), _CAVITY, Swizzle(""), Swizzle("roughness", change=lambda codes: np.invert(codes)),
        ),
        _of("specular", "share of F0 = 0.04", *[_SPECULAR] * 3),
        _THICKNESS,
    ),
    "maya": (
        _COLOUR,
        _normal("aiNormalMap or bump2d in Tangent Space Normals; green points up", up=True),
        _of("roughness", "specularRoughness, alpha is luminance", _ROUGHNESS),
        _of("specular", "specular weight at IOR 1.5", _SPECULAR),
        _THICKNESS,
    ),
}  # fmt: skip
"""Textures of each kit."""


def write_engine_kit(source: ArchiveFile, folder: Path, tool: str) -> list[Path]:
    """Levels of detail, textures, the environment, and ``kit.json``, which says what is what.

    BadArchive: the archive cannot be used. OutputFault: a file could not be written.
    """
    charts, facts = KitCharts(source), kit_facts(source)  # what can be refused comes before what is written
    more = ("mesh/head.usda", "mesh/head.mtlx", "maps/") if tool == "maya" else ()
    always = ("LICENSES.md", "maps/displacement.png", "maps/wrinkle_", "mesh/hair.usda", "mesh/beard.usda")
    written = write_light(source, folder) + extract(source, folder, (*always, *more))
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
    levels = []
    for number, level in enumerate(levels_of_detail(parts)):
        path = folder / f"head_lod{number}.glb"
        data = glb_bytes(
            level, pictures, units=facts["units"], expression=facts["expression"],
            head=str(head.get("name", "head")), licence=str(head.get("licence", "unknown")),
        )  # fmt: skip
        write(path, data)
        written.append(path)
        levels.append({"file": path.name, "triangles": sum(map(triangles, level))})
    facts = {"tool": tool, "levels": levels, "textures": textures, **facts}
    write(folder / "kit.json", (json.dumps(facts, indent=1) + "\n").encode())
    return [*written, folder / "kit.json"]


LEVELS = (24_000, 12_000, 6_000, 2_000)
"""Triangles of the head at LOD 0 to 3, without hair, lashes and other cards, which get fewer in proportion."""

WIDEST = 2.0
"""Most by which ribbons of hair get wider."""

JUDGED: tuple[tuple[str, ...], ...] = (
    ("jawOpen",), ("eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight", "browInnerUp"),
    ("mouthPucker", "browDownLeft", "browDownRight"),
)  # fmt: skip
"""Poses, each of units at 1, in which a reduced surface keeps its shape too."""


def levels_of_detail(parts: Sequence[MeshPart]) -> list[list[MeshPart]]:
    """Parts at each of ``LEVELS``, each with its texture coordinates and blendshapes.

    Of finer ones the skin is subdivided first (Catmull and Clark 1978). Coarser ones keep a subset of the vertices
    (``service.geometry.remesh``), so that texture coordinates, joints and blendshapes stay what they were; the shape is
    kept at rest and in the poses of ``JUDGED``. Of hair fewer ribbons are kept, whole ones, and they get wider: half a
    ribbon has no tip.
    """
    coarse_count = sum(triangles(part) for part in parts if part.material.alpha == "opaque")
    finer = [subdivided_part(part) if part.material.displacement_map is not None else part for part in parts]
    made: list[list[MeshPart]] = []
    for source, levels in (
        (finer, [wanted for wanted in LEVELS if wanted > coarse_count]),
        (parts, [wanted for wanted in LEVELS if wanted <= coarse_count]),
    ):
        count = sum(triangles(part) for part in source if part.material.alpha == "opaque")
        solid = [min(wanted / max(count, 1), 1.0) for wanted in levels]
        cards = [min(wanted / LEVELS[0], 1.0) for wanted in levels]
        columns = [reduced(part, solid if part.material.alpha == "opaque" else cards) for part in source]
        made += [[column[number] for column in columns] for number in range(len(levels))]
    return made


def triangles(part: MeshPart) -> int:
    """How many triangles a part has."""
    polygons = part.polygons
    return len(polygons) + int((polygons[:, 3] >= 0).sum())


def subdivided_part(part: MeshPart) -> MeshPart:
    """A part after one smooth step of subdivision."""
    step = Subdivision.of(part.polygons, len(part.neutral))
    chart = Subdivision.of(part.polygons_uv, len(part.uv))
    neutral = step.smooth(part.neutral).astype(np.float32)
    return replace(
        part,
        vertices=neutral,
        neutral=neutral,
        faces=step.quads.astype(np.int32),
        uv=chart.linear(part.uv).astype(np.float32),
        uv_faces=chart.quads.astype(np.int32),
        targets={unit: step.smooth(offsets).astype(np.float32) for unit, offsets in part.targets.items()},
        normals=None,  # of the finer surface
    )


def reduced(part: MeshPart, shares: Sequence[float]) -> list[MeshPart]:
    """A part with about each share, descending, of its triangles, one texture coordinate per vertex."""
    if part.normals is not None and part.uv_faces is None:
        return [_fewer_ribbons(part, share) for share in shares]
    piece = Piece.of(part)
    wanted = [max(round(len(piece.triangles) * share), 4) for share in shares]
    # At rest, and in each pose that moves it.
    moving = ([part.targets[unit] for unit in units if unit in part.targets] for units in JUDGED)
    poses = [part.neutral, *(np.asarray(part.neutral + sum(offsets), np.float32) for offsets in moving if offsets)]
    return [_with(part, piece, kept) for kept in collapsed(poses, piece.triangles, piece.vertex, wanted)]


def _fewer_ribbons(part: MeshPart, share: float) -> MeshPart:
    """Hair with a share of its ribbons, spread evenly over it, wider by so much that they cover as much."""
    triangles = part_triangles(part.polygons)
    count = len(part.neutral)
    ends = triangles[:, :2].ravel(), triangles[:, 1:].ravel()
    edges = coo_matrix((np.ones(len(ends[0])), ends), (count, count))
    pieces, label = connected_components(edges, directed=False)
    # A ribbon has two triangles fewer than vertices; the cap over the scalp has more, and is kept.
    ribbon = np.bincount(label[triangles[:, 0]], minlength=pieces) == np.bincount(label) - 2
    number = np.cumsum(ribbon)
    kept = ~ribbon | (np.floor(number * share) > np.floor((number - 1) * share))
    points = part.neutral.copy()
    # Both sides of a row follow each other.
    rows = np.flatnonzero(ribbon[label])[::2]
    middle = 0.5 * (points[rows] + points[rows + 1])
    wider = np.float32(min(share**-0.5, WIDEST))
    for side in (0, 1):
        points[rows + side] = middle + wider * (points[rows + side] - middle)
    used, index = np.unique(triangles[kept[label[triangles[:, 0]]]], return_inverse=True)
    normals = None if part.normals is None else part.normals[used]
    return replace(
        part, vertices=points[used], neutral=points[used], faces=index.reshape(-1, 3).astype(np.int32),
        uv=part.uv[used], normals=normals,
    )  # fmt: skip


def _with(part: MeshPart, piece: Piece, kept: Int64) -> MeshPart:
    """The part with some triangles (M, 3) of its piece."""
    used, index = np.unique(kept, return_inverse=True)
    vertex = piece.vertex[used]
    return replace(
        part,
        vertices=part.neutral[vertex],
        neutral=part.neutral[vertex],
        faces=index.reshape(-1, 3).astype(np.int32),
        uv=piece.uv[used],
        uv_faces=None,
        targets={unit: offsets[vertex] for unit, offsets in part.targets.items()},
        normals=None if part.normals is None else part.normals[vertex],
    )
