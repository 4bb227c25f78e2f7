"""Reads ``mesh/head.usda`` back, meshes and blendshapes: only the text that ``service.archive.usd`` writes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from service.archive.usd import REST
from service.arrays import Float32, Int32
from service.errors import BadArchive, NumericFault
from service.materials.material import Material
from service.materials.part import MeshPart

MOST_BYTES = 256 << 20

_MESH = re.compile(r'^    def Mesh "(\w+)"', re.M)
_SHAPE = re.compile(r'^        def BlendShape "(\w+)"', re.M)


def read_parts(data: bytes, manifest: Mapping[str, Any], materials: Mapping[str, Material]) -> list[MeshPart]:
    """Parts in their neutral pose; ``vertices`` is neutral too.

    Args:
        data: the file.
        manifest: says which material and which bone each part has.
        materials: by name.

    Raises:
        BadArchive: the file is not as the archive's.
    """
    if len(data) > MOST_BYTES:
        raise BadArchive(f"mesh/head.usda has {len(data)} bytes; at most {MOST_BYTES} are accepted")
    try:
        text = data.decode("ascii")
        known = {part["name"]: part for part in manifest["parts"]}
        starts = [*_MESH.finditer(text)]
        ends = [*(one.start() for one in starts[1:]), len(text)]
        blocks = [(one[1], text[one.start() : end]) for one, end in zip(starts, ends, strict=True)]
        return [_part(name, block, known[name], materials) for name, block in blocks]
    except (UnicodeDecodeError, KeyError, ValueError, IndexError, TypeError, NumericFault) as error:
        raise BadArchive(f"mesh/head.usda of the archive cannot be read: {error}") from error


def _part(name: str, block: str, facts: Mapping[str, Any], materials: Mapping[str, Material]) -> MeshPart:
    shapes = [*_SHAPE.finditer(block)]
    own = block[: shapes[0].start()] if shapes else block
    points = _rows(own, "point3f[] points", 3)
    counts = _whole(own, "int[] faceVertexCounts")
    corners, uv = _whole(own, "int[] faceVertexIndices"), _rows(own, "texCoord2f[] primvars:st", 2)
    places = _whole(own, "int[] primvars:st:indices") if "primvars:st:indices" in own else corners
    targets = {}
    ends = [*(shape.start() for shape in shapes), len(block)][1:]  # none for a part that no unit moves
    for one, end in zip(shapes, ends, strict=True):
        text = block[one.start() : end]
        moved = np.zeros_like(points)
        moved[_whole(text, "int[] pointIndices")] = _rows(text, "vector3f[] offsets", 3)
        if one[1] != REST:
            targets[one[1]] = moved
    return MeshPart(
        name=name,
        vertices=points,
        neutral=points,
        faces=_polygons(counts, corners),
        uv=uv,
        uv_faces=_polygons(counts, places),
        material=materials[facts["material"]],
        targets=targets,
        bone=facts["bone"],
    )


def _polygons(counts: Int32, flat: Int32) -> Int32:
    polygons = np.full((len(counts), 4), -1, np.int32)
    polygons[np.arange(4) < counts[:, None]] = flat
    return polygons


def _values(text: str, key: str) -> str:
    start = text.index(f"{key} = [") + len(key) + 4
    return text[start : text.index("]", start)]


def _rows(text: str, key: str, width: int) -> Float32:
    flat = _values(text, key).replace("(", "").replace(")", "")
    return np.array(flat.split(",") if flat else [], np.float64).reshape(-1, width).astype(np.float32)


def _whole(text: str, key: str) -> Int32:
    flat = _values(text, key)
    return np.array(flat.split(",") if flat else [], np.int32)
