"""``mesh/head.glb``: the neutral head with its blendshapes as morph targets.

trimesh writes no morph targets, so the file is assembled in ``gltf.py``. glTF has metres, +Y up, the face towards +Z,
and v increasing downwards, so only v changes. Every part is a separate mesh with the same list of targets (names in
``mesh.extras.targetNames``), so one set of weights drives all of them. Parts with a normal map have the tangents that
it refers to: along u, made orthogonal to the normal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from service.archive.gltf import GltfWriter
from service.archive.gltf_materials import Materials, Picture
from service.archive.pieces import Piece
from service.arrays import AnyFloat
from service.materials.part import MeshPart

Object = dict[str, Any]


def glb_bytes(
    parts: Sequence[MeshPart],
    charts: Mapping[str, Picture],
    *,
    units: Sequence[str],
    generator: str,
    copyright_notice: str,
    expression: Mapping[str, float],
    extras: Mapping[str, Any],
) -> bytes:
    """Binary glTF of a head in its neutral pose, as all morph weights are zero.

    Args:
        parts: meshes in the order of the file; those of opacity 0 are left out.
        charts: maps of the chart by role, in glTF's coding.
        units: names of the blendshapes, in the order of the targets.
        generator: for ``asset.generator``.
        copyright_notice: for ``asset.copyright``.
        expression: weight of each blendshape in the photo, kept in ``extras.expressionWeights``.
        extras: further ``asset.extras``, JSON values.
    """
    writer = GltfWriter()
    materials = Materials(writer, charts)
    drawn = [part for part in parts if part.material.opacity > 0]
    meshes = [_mesh(writer, Piece.of(part), units, materials) for part in drawn]
    nodes: list[Object] = [{"name": part.name, "mesh": index} for index, part in enumerate(drawn)]
    weights = {name: round(float(expression.get(name, 0.0)), 6) for name in units}
    nodes.append({"name": "head", "children": list(range(len(drawn))), "extras": {"expressionWeights": weights}})
    document: Object = {
        "asset": {"version": "2.0", "generator": generator, "copyright": copyright_notice, "extras": dict(extras)},
        "scene": 0,
        "scenes": [{"name": "avatar", "nodes": [len(drawn)]}],
        "nodes": nodes,
        "meshes": meshes,
        **materials.document(),
    }
    return writer.finish(document)


def _mesh(writer: GltfWriter, piece: Piece, units: Sequence[str], materials: Materials) -> Object:
    flipped = np.stack([piece.uv[:, 0], 1 - piece.uv[:, 1]], 1)
    material = piece.part.material
    primitive: Object = {
        "attributes": {
            "POSITION": writer.add_vertices(piece.part.neutral[piece.vertex], bounds=True),
            "NORMAL": writer.add_vertices(piece.normal),
            "TEXCOORD_0": writer.add_vertices(flipped),
        },
        "indices": writer.add_indices(piece.triangles, len(piece.vertex)),
        "material": materials.add(material),
        "mode": 4,
    }
    if materials.has_normals(material):
        primitive["attributes"]["TANGENT"] = writer.add_vertices(piece.tangents())
    mesh: Object = {"name": piece.part.name, "primitives": [primitive]}
    if units:
        position, turned = piece.offsets(units)
        primitive["targets"] = [
            {
                "POSITION": writer.add_offsets(position[index], bounds=True),
                "NORMAL": writer.add_offsets(turned[index]),
            }
            for index in range(len(units))
        ]
        mesh["weights"] = [0.0] * len(units)
        mesh["extras"] = {"targetNames": list(units)}
    return mesh


def weights_by_name(names: Sequence[str], values: AnyFloat) -> dict[str, float]:
    """Non-zero blendshape weights of a fit by name."""
    return {name: float(value) for name, value in zip(names, values, strict=True) if value != 0}
