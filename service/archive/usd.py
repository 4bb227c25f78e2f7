"""``mesh/head.usda``: the neutral head for USD tools, with blendshapes whose weights give the photo's expression; and
``mesh/hair.usda``: the strands of hair as BasisCurves, for tools that render or groom strands.

A SkelRoot with one Mesh per part (original polygons with ``subdivisionScheme = "none"``, chart as ``primvars:st``,
origin bottom left: face-varying with indices, or one per vertex where the texture has no cuts), the ARKit units as
UsdSkel blendshapes, a skeleton, and one material per kind of surface. Positions are whole micrometres, those of cards
of hair and offsets of blendshapes tens of them.

Strands are linear curves from root to tip on the head at rest, with a width and a colour at each point: what Blender
reads as hair curves, and Houdini and Unreal (with its plug-ins for USD and for hair) as grooms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from service.archive.maps import MapFiles
from service.archive.surfaces import JOINTS, PARENTS, SMALLEST_OFFSET_M, Skeleton
from service.archive.usd_materials import material_text
from service.archive.usd_text import Prim, fixed_tuples, numbers, read_prims, tokens
from service.arrays import Float32, Float64, Int64
from service.hair.groom import Groom
from service.hair.guides import resampled
from service.head.files import split_polygons
from service.materials.part import MeshPart, is_cards, normal_offsets, part_normals

SMALLEST_TURN, TURN_STEP = 0.3, 0.05
"""Blendshapes that turn no normal by more, 17 degrees, have no offsets of normals; the others have them in steps."""

REST = "rest_of_the_photo"
"""Blendshape of weight 1 that holds what the photo's pose has beyond the units, where it has anything."""

_STAGE = '#usda 1.0\n(\n    defaultPrim = "{prim}"\n    doc = "{title}"\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n\n'
_ROOT = 'def SkelRoot "Head" (\n    kind = "component"\n)\n{\n'
_MATERIALS = '    def Scope "Materials"\n    {\n'
_VERTEX = 'interpolation = "vertex"'


def usda_meshes(
    parts: Sequence[MeshPart],
    title: str,
    *,
    units: Sequence[str],
    expression: Mapping[str, float],
    joints: Skeleton,
    weights: Mapping[str, Float32],
) -> str:
    """USD text of the parts up to their materials, for :func:`usda_bytes`.

    Args:
        parts: meshes in the order of the file.
        title: for the stage's documentation.
        units: names of the blendshapes.
        expression: weight of each in the photo; 0 where it has none.
        joints: positions of the skeleton.
        weights: (N, 5) by which the vertices of a part follow the joints, by the part's name; parts without follow
            their bone.
    """
    shapes = {part.name: _blendshapes(part, units, expression) for part in parts}
    names = [*units, *([REST] if any(REST in one for one in shapes.values()) else [])]
    values = [1.0 if name == REST else float(expression.get(name, 0.0)) for name in names]
    blocks = [_STAGE.format(prim="Head", title=title), _ROOT, _skeleton(joints, names, values).text("    ")]
    blocks += [_mesh(part, shapes[part.name], weights.get(part.name)).text("    ") for part in parts]
    return "".join(blocks)


def usda_bytes(meshes: str, parts: Sequence[MeshPart], files: MapFiles) -> bytes:
    """The file of the parts, whose ``usda_meshes`` are given; ``files`` says where the maps lie."""
    used = {part.material.name: part.material for part in parts}
    blocks = [meshes, _MATERIALS, *(material_text(material, files) for material in used.values())]
    return "".join([*blocks, "    }\n}\n"]).encode("ascii")


def joint_paths() -> list[str]:
    """Names of the joints as paths from the root."""
    paths: list[str] = []
    for name, parent in zip(JOINTS, PARENTS, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def read_meshes(data: bytes) -> list[Prim]:
    """Meshes of a file of :func:`usda_bytes`, with blendshapes as their children; ValueError where it is none."""
    text, materials, _ = data.decode("ascii").partition(_MATERIALS)
    if not materials:
        raise ValueError("it ends before its materials")
    head = read_prims(text)[0]
    return [prim for prim in head.children if prim.kind == "Mesh"]


def _skeleton(joints: Skeleton, names: Sequence[str], values: Sequence[float]) -> Prim:
    parents = [np.zeros(3) if parent < 0 else joints.positions[parent] for parent in PARENTS]
    steps = zip(joints.positions, parents, strict=True)
    animation: dict[str, str | None] = {
        "uniform token[] blendShapes": f"[{tokens(names)}]",
        "float[] blendShapeWeights": f"[{numbers(np.round(values, 6))}]",
    }
    made: dict[str, str | None] = {
        "uniform token[] joints": f"[{tokens(joint_paths())}]",
        "uniform matrix4d[] bindTransforms": f"[{', '.join(_moved(one) for one in joints.positions)}]",
        "uniform matrix4d[] restTransforms": f"[{', '.join(_moved(one - before) for one, before in steps)}]",
        "rel skel:animationSource": "</Head/Skeleton/Animation>\n",
    }
    below = [Prim("SkelAnimation", "Animation", animation)]
    return Prim("Skeleton", "Skeleton", made, schemas=("SkelBindingAPI",), children=below)


def _moved(by: Float64) -> str:
    rows = np.eye(4)
    rows[3, :3] = by
    return f"({fixed_tuples(rows, 6)})"


def _blendshapes(part: MeshPart, units: Sequence[str], expression: Mapping[str, float]) -> dict[str, Float32]:
    """Offsets (N, 3) of each blendshape that moves the part."""
    found = {unit: part.targets[unit] for unit in units if unit in part.targets}
    posed = part.neutral + sum((np.float32(expression.get(unit, 0)) * found[unit] for unit in found), np.float32(0))
    rest = part.vertices - posed
    if np.abs(rest).max() > SMALLEST_OFFSET_M:
        found[REST] = np.asarray(rest, np.float32)
    return {name: offsets for name, offsets in found.items() if np.abs(offsets).max() > SMALLEST_OFFSET_M}


def _mesh(part: MeshPart, shapes: Mapping[str, Float32], weights: Float32 | None) -> Prim:
    polygons = part.polygons
    present, corners = polygons >= 0, split_polygons(polygons)
    still = part_normals(part, part.neutral, corners)
    if weights is None:
        weights = np.tile(np.eye(len(JOINTS), dtype=np.float32)[JOINTS.index(part.bone)], (len(part.neutral), 1))
    influences, indices = _influences(weights)
    both = np.concatenate([part.vertices, part.neutral])
    turned = dict(part.turned)
    if REST in shapes:
        turned[REST] = next(normal_offsets(part, corners, still, [shapes[REST]]))
    chart, across = _chart(part)
    paths = ", ".join(f"</Head/{part.name}/{name}>" for name in shapes)
    values: dict[str, str | None] = {
        "uniform bool doubleSided": "true" if part.material.double_sided else "false",
        "uniform token subdivisionScheme": '"none"',
        "float3[] extent": f"[{fixed_tuples([both.min(0), both.max(0)], 6)}]",
        "int[] faceVertexCounts": f"[{numbers(present.sum(1))}]",
        "int[] faceVertexIndices": f"[{numbers(polygons[present])}]",
        "point3f[] points": f"[{fixed_tuples(part.neutral, 5 if is_cards(part) else 6)}]",
        "normal3f[] normals": f"[{fixed_tuples(still, 2)}]",
        **chart,
        "int[] primvars:skel:jointIndices": f"[{numbers(indices)}]",
        "float[] primvars:skel:jointWeights": f"[{numbers(influences)}]",
        "uniform token[] skel:blendShapes": f"[{tokens(list(shapes))}]",
        "rel skel:blendShapeTargets": f"[{paths}]",
        "rel skel:skeleton": "</Head/Skeleton>",
        "rel material:binding": f"</Head/Materials/{part.material.name}>",
    }
    influence = (f"elementSize = {influences.shape[1]}", _VERTEX)
    facts = {
        "normal3f[] normals": (_VERTEX,), "texCoord2f[] primvars:st": (across,),
        "int[] primvars:skel:jointIndices": influence, "float[] primvars:skel:jointWeights": influence,
    }  # fmt: skip
    below = [_shape(name, offsets, turned[name]) for name, offsets in shapes.items()]
    return Prim("Mesh", part.name, values, facts, ("MaterialBindingAPI", "SkelBindingAPI"), below)


def _influences(weights: Float32) -> tuple[Float32, Int64]:
    """The largest weights (N, k) of each vertex and their joints (N, k), with the least k that leaves nothing out.

    In steps of 1/64, short as text, that sum to 1 exactly: else the origin would pull at the vertices.
    """
    count = max(int((weights > 0).sum(1).max()), 1)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    steps = np.rint(np.take_along_axis(weights, order, 1) * 64)
    steps[:, 0] += 64 - steps.sum(1)
    return np.asarray(steps / 64, np.float32), order


def _chart(part: MeshPart) -> tuple[dict[str, str | None], str]:
    """The primvar ``st`` of a part, and its interpolation."""
    if part.uv_faces is None:
        return {"texCoord2f[] primvars:st": f"[{fixed_tuples(part.uv, 4 if is_cards(part) else 5)}]"}, _VERTEX
    places = part.polygons_uv
    used, index = np.unique(places[places >= 0], return_inverse=True)
    return {
        "texCoord2f[] primvars:st": f"[{fixed_tuples(part.uv[used], 5)}]",
        "int[] primvars:st:indices": f"[{numbers(index)}]",
    }, 'interpolation = "faceVarying"'


def _shape(name: str, offsets: Float32, turned: Float32) -> Prim:
    moved = np.flatnonzero(np.linalg.norm(offsets, axis=1) > SMALLEST_OFFSET_M)
    values: dict[str, str | None] = {"uniform vector3f[] offsets": f"[{fixed_tuples(offsets[moved], 5)}]"}
    if np.abs(turned[moved]).max(initial=0.0) > SMALLEST_TURN:
        steps = np.rint(turned[moved] / TURN_STEP) * TURN_STEP
        values["uniform vector3f[] normalOffsets"] = f"[{fixed_tuples(steps, 2)}]"
    return Prim("BlendShape", name, values | {"uniform int[] pointIndices": f"[{numbers(moved)}]"})


MOST_POINTS = 48
"""Of a strand in the file."""
WIDTH_M = 8e-5
"""Of a hair at its root: 0.05 to 0.1 mm (Robbins 2012, "Chemical and Physical Behavior of Human Hair", table 1.1)."""
TIP = 0.3
"""Width of the tip over that of the root."""


def curves_bytes(groom: Groom, title: str) -> bytes:
    """USD text of strands, at least one, positions to 10 micrometres."""
    count = min(groom.strands.shape[1], MOST_POINTS)
    strands = resampled(groom.strands, np.ones(len(groom), np.float32), count)
    colour = groom.colour.linear(count).reshape(-1, 3)
    along = np.linspace(0, 1, count)
    width = WIDTH_M * (1 - (1 - TIP) * along**3)
    points, half = strands.reshape(-1, 3), 0.5 * WIDTH_M
    values: dict[str, str | None] = {
        "uniform token type": '"linear"',
        "uniform token wrap": '"nonperiodic"',
        "float3[] extent": f"[{fixed_tuples([points.min(0) - half, points.max(0) + half], 6)}]",
        "int[] curveVertexCounts": f"[{numbers(np.full(len(groom), count))}]",
        "point3f[] points": f"[{fixed_tuples(points, 5)}]",
        "float[] widths": f"[{','.join([numbers(np.round(width, 6))] * len(groom))}]",
        "color3f[] primvars:displayColor": f"[{fixed_tuples(colour, 3)}]",
    }
    facts = {"float[] widths": (_VERTEX,), "color3f[] primvars:displayColor": (_VERTEX,)}
    return (_STAGE.format(prim="Hair", title=title) + Prim("BasisCurves", "Hair", values, facts).text("")).encode(
        "ascii"
    )
