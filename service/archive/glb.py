"""``mesh/head.glb``: the neutral head with its blendshapes as morph targets.

trimesh writes no morph targets, so the file is assembled in ``gltf.py``. glTF has metres, +Y up, the face towards +Z,
and v increasing downwards, so only v changes. Every part is a separate mesh with the same list of targets (names in
``mesh.extras.targetNames``), so one set of weights drives all of them. Where there is a normal map the skin has the
tangents that it refers to: along u, made orthogonal to the normal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.archive.gltf import GltfWriter
from service.archive.surface import Part, split_parts, vertex_normals
from service.arrays import AnyFloat, Float32, Float64
from service.errors import NumericFault
from service.geometry.chart import any_orthogonal, tangents
from service.head.model import HeadModel
from service.materials.material import Material
from service.materials.of_head import material_of

Object = dict[str, Any]

SMALLEST_OFFSET_M = 1e-6
"""Shorter position offsets of a morph target are written as 0."""
SMALLEST_TURN = 0.01
"""Shorter normal offsets of a morph target are written as 0: about half a degree."""

SPECULAR = "KHR_materials_specular"

_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071


@dataclass(frozen=True)
class Picture:
    """An encoded texture: ``data`` in format ``mime`` ("image/png" or "image/jpeg")."""

    data: bytes
    mime: str


def glb_bytes(
    head: HeadModel,
    neutral: AnyFloat,
    texture: Picture,
    *,
    normal: Picture | None = None,
    specular: Picture | None = None,
    generator: str,
    copyright_notice: str,
    expression: Mapping[str, float],
    extras: Mapping[str, Any],
) -> bytes:
    """Binary glTF of a head.

    Args:
        head: topology, chart and blendshapes.
        neutral: (V, 3) metres without expression; the pose of the file, as all morph weights are zero.
        texture: colours of the chart.
        normal: tangent-space normals of the skin, +Y up, on the same chart.
        specular: alpha is the skin's specular factor (extension KHR_materials_specular).
        generator: for ``asset.generator``.
        copyright_notice: for ``asset.copyright``.
        expression: weight of each blendshape in the photo, kept in ``extras.expressionWeights``.
        extras: further ``asset.extras``, JSON values.

    Raises:
        NumericFault: a vertex or blendshape is not finite (glTF has no NaN).
    """
    if not (np.isfinite(neutral).all() and np.isfinite(head.expression).all()):
        raise NumericFault("the head or one of its blendshapes is not finite")
    writer = GltfWriter()
    base = np.asarray(neutral, np.float32)
    morphs = _Morphs.of(head, base)
    parts = [part for part in split_parts(head) if material_of(part.name).opacity > 0]
    materials = list(dict.fromkeys(material_of(part.name) for part in parts))
    along = None if normal is None else tangents(head, base)
    meshes = [_mesh(writer, head, part, base, morphs, materials.index(material_of(part.name)), along) for part in parts]
    nodes: list[Object] = [{"name": part.name, "mesh": index} for index, part in enumerate(parts)]
    weights = {name: round(float(expression.get(name, 0.0)), 6) for name in head.expression_names}
    nodes.append({"name": "head", "children": list(range(len(parts))), "extras": {"expressionWeights": weights}})
    pictures = {"texture": texture, "normal": normal, "specular": specular}
    there = {name: picture for name, picture in pictures.items() if picture is not None}
    index = {name: number for number, name in enumerate(there)}
    document: Object = {
        "asset": {"version": "2.0", "generator": generator, "copyright": copyright_notice, "extras": dict(extras)},
        "scene": 0,
        "scenes": [{"name": "avatar", "nodes": [len(parts)]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [_material(material, index) for material in materials],
        "textures": [{"name": name, "source": number, "sampler": 0} for name, number in index.items()],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": [
            {"name": name, "mimeType": picture.mime, "bufferView": writer.add_raw(picture.data)}
            for name, picture in there.items()
        ],
    }
    if specular is not None:
        document["extensionsUsed"] = [SPECULAR]
    return writer.finish(document)


@dataclass(frozen=True)
class _Morphs:
    """Offsets of every blendshape, (E, V, 3) float32, zero where they are negligible."""

    names: tuple[str, ...]
    position: Float32
    normal: Float32
    base_normal: Float32

    @classmethod
    def of(cls, head: HeadModel, neutral: Float32) -> _Morphs:
        base = vertex_normals(neutral, head.triangles)
        if not len(head.expression):
            empty = np.zeros((0, len(neutral), 3), np.float32)
            return cls(head.expression_names, empty, empty, base)
        turned = vertex_normals(neutral + head.expression, head.triangles) - base
        return cls(head.expression_names, _cut(head.expression, SMALLEST_OFFSET_M), _cut(turned, SMALLEST_TURN), base)


def _cut(offsets: Float32, least: float) -> Float32:
    """Offsets with rows shorter than ``least`` set to zero."""
    small = np.einsum("evc,evc->ev", offsets, offsets) < least * least
    return np.where(small[..., None], np.float32(0), offsets)


def _mesh(
    writer: GltfWriter,
    head: HeadModel,
    part: Part,
    neutral: Float32,
    morphs: _Morphs,
    material: int,
    along: Float64 | None,
) -> Object:
    flipped = np.stack([head.uv[part.uv, 0], 1 - head.uv[part.uv, 1]], 1)
    primitive: Object = {
        "attributes": {
            "POSITION": writer.add_vertices(neutral[part.vertex], bounds=True),
            "NORMAL": writer.add_vertices(morphs.base_normal[part.vertex]),
            "TEXCOORD_0": writer.add_vertices(flipped),
        },
        "indices": writer.add_indices(part.triangles, len(part.vertex)),
        "material": material,
        "mode": 4,
    }
    if along is not None and material_of(part.name).detailed:
        frame = _tangents(along[part.uv], morphs.base_normal[part.vertex])
        primitive["attributes"]["TANGENT"] = writer.add_vertices(frame)
    mesh: Object = {"name": part.name, "primitives": [primitive]}
    if morphs.names:
        primitive["targets"] = [
            {
                "POSITION": writer.add_offsets(morphs.position[index, part.vertex], bounds=True),
                "NORMAL": writer.add_offsets(morphs.normal[index, part.vertex]),
            }
            for index in range(len(morphs.names))
        ]
        mesh["weights"] = [0.0] * len(morphs.names)
        mesh["extras"] = {"targetNames": list(morphs.names)}
    return mesh


def _tangents(along: Float64, normal: Float32) -> Float32:
    """(N, 4) unit tangents along u, orthogonal to the normals, and handedness 1: normal x tangent points along +v."""
    flat = along.astype(np.float32) - normal * np.einsum("ni,ni->n", along.astype(np.float32), normal)[:, None]
    # Where the direction of u is degenerate (a pole, a sliver) the tangent is arbitrary.
    degenerate = np.einsum("ni,ni->n", flat, flat) < 1e-6
    flat[degenerate] = any_orthogonal(normal[degenerate])
    unit = flat / np.sqrt(np.einsum("ni,ni->n", flat, flat))[:, None]
    return np.concatenate([unit, np.ones((len(unit), 1), np.float32)], 1)


def _material(material: Material, textures: Mapping[str, int]) -> Object:
    surface: Object = {"metallicFactor": 0.0, "roughnessFactor": material.roughness}
    if material.textured:
        surface["baseColorTexture"] = {"index": 0}
    if material.colour != (1.0, 1.0, 1.0) or material.opacity < 1:
        surface["baseColorFactor"] = [*material.colour, material.opacity]
    written: Object = {"name": material.name, "pbrMetallicRoughness": surface}
    if material.detailed and "normal" in textures:
        written["normalTexture"] = {"index": textures["normal"]}
    if material.detailed and "specular" in textures:
        written["extensions"] = {SPECULAR: {"specularTexture": {"index": textures["specular"]}}}
    if material.opacity < 1:
        written["alphaMode"] = "BLEND"
    if material.double_sided:
        written["doubleSided"] = True
    return written


def weights_by_name(names: Sequence[str], values: AnyFloat) -> dict[str, float]:
    """Non-zero blendshape weights of a fit by name."""
    return {name: float(value) for name, value in zip(names, values, strict=True) if value != 0}
