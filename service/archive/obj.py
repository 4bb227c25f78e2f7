"""``mesh/head.obj``, ``mesh/parts.obj`` and their ``mesh/head.mtl``.

The head has the photo's expression; its mesh is whole, on one chart and of the same topology in every archive. Parts
with textures of their own, such as hair and the finer eyes and teeth, are a file of their own: no ray that looks for
the head meets them. Metres, +Y up, +Z out of the face, unposed (the camera holds the pose). The original polygons, a
``vt`` per chart vertex with its origin bottom left, one object, group and material per part. OBJ has no unit, so the
header names it.

Materials have the PBR keys that importers of Blender, Maya and others read. Blender reads ``Ks`` as its specular level
(0.5 is the F0 that ``Ni`` gives), ``Pr`` as roughness, and a normal map only as ``map_Bump -bm 1``; ``norm`` is for
others. It takes every texture of an MTL file for sRGB but EXR, so all that are no colours come as EXR
(:func:`data_maps`).

Read is an OBJ file in its own order, as libraries for OBJ merge, split or reorder vertices, whose order is the
correspondence to the head's chart; anything but ``v``, ``vt``, ``vn``, ``f`` and the names of parts is ignored.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from service.archive.images import decode_normals8, exr_bytes
from service.archive.maps import MapFiles
from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int32, Int64, UInt8
from service.errors import BadMesh, NumericFault
from service.geometry.mesh import area_normals
from service.head.files import split_polygons, triangle_fields
from service.head.model import HeadModel
from service.image_filters import shrunk
from service.materials.material import ChartMap, Map, Material, OwnMap
from service.materials.part import MeshPart, is_cards, material_of, part_normals, renumbered

_HEADER = """\
# {title}
# unit: metre; +Y up, +Z out of the face, +X to the subject's left; the photo's expression, without the head's pose
# vt origin: bottom left; {vertices} vertices, {polygons} polygons
mtllib head.mtl
"""


def obj_bytes(head: HeadModel, vertices: AnyFloat, title: str) -> bytes:
    """OBJ text of ``vertices`` (V, 3) metres with the topology of ``head``, to the micrometre.

    The vertices are in the head model's order, so the same line of two archives is the same point of two heads.
    NumericFault: a vertex is not finite.
    """
    if not np.isfinite(vertices).all():
        raise NumericFault(f"vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])} of the head is not finite")
    normals = [area_normals(vertices, head.triangles)]
    return _text(title, len(head.polygons), [vertices], [head.uv], normals, _own_faces(head))


def parts_obj_bytes(parts: Sequence[MeshPart], title: str) -> bytes:
    """OBJ text of parts beside the head's own, in the photo's expression; materials are those of ``head.mtl``.

    They have one smoothing group each and no normals, which every reader computes, but for parts that are lit with
    others. Places on the chart and normals that are alike are written once.
    """
    points = [part.vertices for part in parts]
    charts = [_distinct(part.uv, PART_DIGITS["vt"]) for part in parts]
    normals = [
        _distinct(part_normals(part, part.vertices, split_polygons(part.polygons)), PART_DIGITS["vn"])
        if is_cards(part) or part.normals is not None else None
        for part in parts
    ]  # fmt: skip
    faces, before = [], np.zeros(3, np.int64)
    for part, (chart, place), normal in zip(parts, charts, normals, strict=True):
        columns = [part.polygons + before[0], place[part.polygons_uv] + before[1]]
        columns += [] if normal is None else [normal[1][part.polygons] + before[2]]
        faces += [_begin(part.name, part.material.name), *_faces(part.polygons, columns)]
        before += [len(part.vertices), len(chart), 0 if normal is None else len(normal[0])]
    directions = [rows for rows, _ in filter(None, normals)]
    count = sum(len(part.faces) for part in parts)
    return _text(title, count, points, [chart for chart, _ in charts], directions, faces, PART_DIGITS)


HEAD_DIGITS = {"v": 6, "vt": 6, "vn": 4}
PART_DIGITS = {"v": 5, "vt": 5, "vn": 2}
"""Decimals of a line: 10 micrometres, a fiftieth of a texel of 2048 and half a degree for parts."""


def _distinct(rows: AnyFloat, decimals: int) -> tuple[Float64, Int64]:
    """Rows (N, C), rounded, each once, and which of them (N,) each was: ribbons of hair share most of theirs."""
    coded = np.rint(np.asarray(rows, np.float64) * 10**decimals).astype(np.int64)
    key = coded[:, 0]
    for column in coded.T[1:]:
        key = (key << 21) + column
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    return coded[first] / 10**decimals, place


def _text(
    title: str, polygons: int, points: Sequence[AnyFloat], charts: Sequence[AnyFloat], normals: Sequence[AnyFloat],
    faces: Iterable[str], digits: Mapping[str, int] = HEAD_DIGITS,
) -> bytes:  # fmt: skip
    """The file; numbers of parts are written less finely than those of the head."""
    blocks = [_HEADER.format(title=title, vertices=sum(map(len, points)), polygons=polygons)]
    for kind, several in (("v", points), ("vt", charts), ("vn", normals)):
        number = f" %.{digits[kind]}f"
        for rows in several:
            blocks += _lines(f"{kind}{number * rows.shape[1]}\n", rows)
    return "".join([*blocks, *faces]).encode("ascii")


def _lines(pattern: str, rows: AnyFloat) -> Iterator[str]:
    for some in _blocks(rows):
        values = np.asarray(some, np.float64) + 0.0  # -0.0 becomes 0.0
        yield (pattern * len(values)) % tuple(values.ravel().tolist())


Rows = TypeVar("Rows", AnyFloat, AnyInt)


def _blocks(rows: Rows) -> Iterator[Rows]:
    """Rows, some at a time: as Python numbers they take ten times the memory."""
    return (rows[first : first + 16384] for first in range(0, len(rows), 16384))


def _own_faces(head: HeadModel) -> Iterator[str]:
    for index, name in enumerate(head.part_names):
        chosen = head.polygon_part == index
        if chosen.any():
            yield _begin(name, material_of(name).name)
            own = head.polygons[chosen]
            yield from _faces(own, [own, head.polygon_uv[chosen], own])


def _begin(name: str, material: str) -> str:
    return f"o {name}\ng {name}\nusemtl {material}\ns 1\n"


def _faces(polygons: Int32, columns: Sequence[AnyInt]) -> Iterator[str]:
    """Lines ``f v/vt/vn ...`` or ``f v/vt ...`` in the order of the polygons (Q, 4), -1 in the last column of a
    triangle.

    Columns are (Q, 4) each: vertices, places on the chart and, where there are any, normals, counted from 0.
    """
    corner = "/".join(["%d"] * len(columns))
    triangle, quad = (f"f {' '.join([corner] * count)}\n" for count in (3, 4))
    for some in _blocks(np.stack([polygons, *columns], 2)):
        present = some[..., 0] >= 0
        patterns = np.where(present[:, 3], quad, triangle)
        yield "".join(patterns.tolist()) % tuple((some[present, 1:] + 1).ravel().tolist())


LEVEL = 0.5
"""Specular level of ``Ks`` that stands for the whole F0 of the index of refraction."""


def mtl_bytes(materials: Iterable[Material], files: MapFiles) -> bytes:
    """MTL text of materials, each once by name, in order of appearance."""
    distinct = {material.name: material for material in materials}
    return "\n".join(_mtl_lines(material, files) for material in distinct.values()).encode("ascii")


def _mtl_lines(material: Material, files: MapFiles) -> str:
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
        f"d {material.opacity:g}",
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


def data_maps(materials: Iterable[Material], files: MapFiles, charts: Mapping[str, Float32]) -> dict[str, bytes]:
    """Name in the archive -> EXR of every map that is no colour.

    ``charts`` are the values of the chart's maps by role: normals (h, w, 3) in [-1, 1], the others (h, w) in [0, 1].
    """
    made: dict[str, bytes] = {}
    for material in materials:
        for slot, one in (
            ("specular", material.specular_map), ("roughness", material.roughness_map), ("normal", material.normal_map),
        ):  # fmt: skip
            path = data_path(one, files)
            if one is None or path is None:
                continue
            name = path.removeprefix("../") if path.startswith("../") else f"mesh/{path}"
            if name not in made:
                values = charts[one.role] if isinstance(one, ChartMap) else _own_values(one, slot)
                if material.strand_map is not None:  # noise that compresses badly, and at a distance is none
                    values = shrunk(values, (values.shape[1] // 2, values.shape[0] // 2))
                made[name] = exr_bytes(_coded(values, slot))
    return made


def _own_values(one: OwnMap, slot: str) -> Float32:
    pixels: UInt8 = one.pixels
    if slot == "normal":
        return decode_normals8(pixels[..., :3])
    return np.asarray((pixels if pixels.ndim == 2 else pixels[..., 0]) / np.float32(255), np.float32)


def _coded(values: Float32, slot: str) -> Float32:
    """Normals as 0.5 + 0.5 n, specular as a level, roughness as it is, in steps of 1/256, which compress well."""
    factor, shift = {"normal": (0.5, 0.5), "specular": (LEVEL, 0.0), "roughness": (1.0, 0.0)}[slot]
    codes = np.rint(values * np.float32(256 * factor) + np.float32(256 * shift))
    return np.asarray(codes / np.float32(256), np.float32)


MAX_BYTES = 64 << 20
MAX_VERTICES = 500_000
MAX_PARTS = 64


@dataclass(frozen=True)
class ObjMesh:
    """A mesh in the order of its file.

    Attributes:
        vertices: (V, 3) float64, finite.
        uv: (U, 2) float64, origin bottom left; (0, 2) where the file has none.
        polygons: (Q, 4) int32 vertex indices, -1 in the last column marks a triangle.
        polygon_uv: (Q, 4) int32 indices into ``uv``, -1 as in ``polygons``; all -1 where a face has none.
        part_names: names of ``o`` (``g`` where there is no ``o``), in order of appearance.
        polygon_part: (Q,) uint8 index into ``part_names``.
        normals: (V, 3) float64 of the vertices, of each that of its last corner; 0 where the file has none.
    """

    vertices: Float64
    uv: Float64
    polygons: Int32
    polygon_uv: Int32
    part_names: tuple[str, ...]
    polygon_part: UInt8
    normals: Float64 | None = None

    def part(self, name: str) -> ObjMesh:
        """One of the parts by itself, with its own vertices and texture coordinates; BadMesh: there is no such part."""
        if name not in self.part_names:
            raise BadMesh(f"the mesh has no part {name[:40]!r}; it has {', '.join(self.part_names)[:200]}")
        chosen = self.polygon_part == self.part_names.index(name)
        used, polygons = renumbered(self.polygons[chosen])
        places, polygon_uv = renumbered(self.polygon_uv[chosen])
        normals = None if self.normals is None else self.normals[used]
        own = np.zeros(len(polygons), np.uint8)
        return ObjMesh(self.vertices[used], self.uv[places], polygons, polygon_uv, (name,), own, normals)

    def as_head(self, name: str, licence: str) -> HeadModel:
        """A head model with this topology, chart and shape, and without bases, landmarks or regions.

        BadMesh: a face has no chart coordinates, or they are outside [0, 1].
        """
        if (self.polygon_uv[:, :3] < 0).any():
            raise BadMesh("the mesh has faces without texture coordinates (vt), which its maps need")
        if not ((self.uv >= 0) & (self.uv <= 1)).all():
            raise BadMesh("texture coordinates of the mesh are outside [0, 1]; all its maps have to share one chart")
        count = len(self.vertices)
        none, ints = np.zeros((0, count, 3), np.float32), np.zeros(0, np.int32)
        corners = triangle_fields(self.polygons, self.polygon_uv, self.polygon_part)
        return HeadModel(
            name=name, licence=licence, mean=self.vertices.astype(np.float32), identity=none, expression=none,
            expression_names=(), polygons=self.polygons, polygon_uv=self.polygon_uv, polygon_part=self.polygon_part,
            part_names=self.part_names, uv=self.uv.astype(np.float32), mirror=np.arange(count, dtype=np.int32),
            landmark_triangle=ints, landmark_barycentric=np.zeros((0, 3), np.float32),
            landmark_spread=np.zeros(0, np.float32), contour_landmarks=ints,
            contour_yaw_deg=np.zeros(0, np.float32), contour_triangle=np.zeros((0, 0), np.int32),
            contour_barycentric=np.zeros((0, 0, 3), np.float32), region_names=(),
            regions=np.zeros((0, count), np.float32), **corners,
        )  # fmt: skip


def read_obj(data: bytes) -> ObjMesh:
    """Read an OBJ file.

    BadMesh, whose message names the line: too large, not text, a coordinate that is not a finite number, an index out
    of range, a face without three or four corners, or no face.
    """
    if len(data) > MAX_BYTES:
        raise BadMesh(f"the OBJ file has {len(data)} bytes; at most {MAX_BYTES} are accepted")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadMesh("the OBJ file is not text; a Wavefront OBJ file is expected") from error
    vertices: list[list[float]] = []
    uv: list[list[float]] = []
    normals: list[list[float]] = []
    normal_of: dict[int, int] = {}
    faces: list[tuple[list[int], list[int], int]] = []
    names: list[str] = []
    objects, current = False, 0
    for number, line in enumerate(text.splitlines(), 1):
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append(_numbers(number, words, 3))
        elif kind == "vt":
            uv.append(_numbers(number, words, 2))
        elif kind == "vn":
            normals.append(_numbers(number, words, 3))
        elif kind == "f":
            names = names or ["skin"]
            corners, places_of = _face(number, words, len(vertices), len(uv))
            faces.append((corners, places_of, current))
            if normals and words[0].count("/") == 2:
                turned = (_index(number, word.rpartition("/")[2], len(normals), "vn") for word in words)
                normal_of.update(zip(corners, turned, strict=False))
        elif kind == "o" or (kind == "g" and not objects):
            objects |= kind == "o"
            name = " ".join(words) or "unnamed"
            names += [name] * (name not in names)
            current = names.index(name)
        if len(vertices) > MAX_VERTICES or len(names) > MAX_PARTS:
            raise BadMesh(f"the mesh has more than {MAX_VERTICES} vertices or {MAX_PARTS} parts, the most accepted")
    if not faces:
        raise BadMesh("the OBJ file has no faces; a mesh is expected")
    polygons, places, owners = zip(*faces, strict=True)
    used, owner = np.unique(owners, return_inverse=True)  # exporters write empty groups
    upright = np.zeros((len(vertices), 3))
    if normal_of:
        upright[list(normal_of)] = np.array(normals)[list(normal_of.values())]
    return ObjMesh(
        np.array(vertices, np.float64),
        np.array(uv, np.float64).reshape(-1, 2),
        np.array(polygons, np.int32),
        np.array(places, np.int32),
        tuple(names[index] for index in used),
        owner.astype(np.uint8),
        upright,
    )


def _face(number: int, words: Sequence[str], vertices: int, places: int) -> tuple[list[int], list[int]]:
    """Four vertex and four chart indices of a face, -1 in the last place for a triangle and where there is no chart."""
    if len(words) not in (3, 4):
        raise BadMesh(f"line {number}: a face of {len(words)} corners; three or four are accepted")
    corners = [word.split("/") for word in words]
    vertex = [_index(number, corner[0], vertices, "v") for corner in corners]
    chart = [_index(number, c[1], places, "vt") if len(c) > 1 and c[1] else -1 for c in corners]
    padding = [-1] * (4 - len(words))
    return vertex + padding, (chart if min(chart) >= 0 else [-1] * len(words)) + padding


def _numbers(number: int, words: Sequence[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words[:count]]
    except ValueError as error:
        raise BadMesh(f"line {number}: {' '.join(words)[:60]!r} are not numbers") from error
    if len(values) < count:
        raise BadMesh(f"line {number}: {len(values)} numbers instead of {count}")
    for value in values:
        if not abs(value) < 1e9:
            raise BadMesh(f"line {number}: the coordinate {value} is not finite or not below 1e9")
    return values


def _index(number: int, word: str, count: int, kind: str) -> int:
    """0-based index; OBJ counts from 1, and negative ones from the end."""
    try:
        value = int(word)
    except ValueError as error:
        raise BadMesh(f"line {number}: {word[:20]!r} is not an index") from error
    found = value - 1 if value > 0 else count + value
    if not 0 <= found < count or value == 0:
        raise BadMesh(f"line {number}: a face points to {kind} {value}; there are {count} before it")
    return found
