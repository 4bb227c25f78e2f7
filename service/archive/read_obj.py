"""Reading an OBJ file: positions, chart coordinates, polygons and parts, in the order of the file.

Libraries for OBJ merge, split or reorder vertices, whose order is the correspondence to the head's chart. Anything but
``v``, ``vt``, ``f`` and the names of parts is ignored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.arrays import Float64, Int32, UInt8
from service.errors import BadMesh
from service.head.files import triangle_fields
from service.head.model import HeadModel

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
        """One of the parts by itself, with its own vertices and texture coordinates.

        Raises:
            BadMesh: the mesh has no such part.
        """
        if name not in self.part_names:
            raise BadMesh(f"the mesh has no part {name[:40]!r}; it has {', '.join(self.part_names)[:200]}")
        chosen = self.polygon_part == self.part_names.index(name)
        rows = []
        for index, values in ((self.polygons[chosen], self.vertices), (self.polygon_uv[chosen], self.uv)):
            used, local = np.unique(index[index >= 0], return_inverse=True)
            short = np.full(index.shape, -1, np.int32)
            short[index >= 0] = local
            rows += [(values[used], short)]
        (points, polygons), (uv, places) = rows
        used = np.unique(self.polygons[chosen][self.polygons[chosen] >= 0])
        normals = None if self.normals is None else self.normals[used]
        return ObjMesh(points, uv, polygons, places, (name,), np.zeros(len(polygons), np.uint8), normals)

    def as_head(self, name: str, licence: str) -> HeadModel:
        """A head model with this topology, chart and shape, and without bases, landmarks or regions.

        Raises:
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

    Raises:
        BadMesh: too large, not text, a coordinate that is not a finite number, an index out of range, a face without
            three or four corners, or no face; the message names the line.
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
