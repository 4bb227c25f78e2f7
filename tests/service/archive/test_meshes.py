"""OBJ, GLB and USD say the same head; read by parsers that share no code with the writers.

Strands as USD curves, as USD's own library reads them.
"""

from __future__ import annotations

import importlib
import json
import shutil
import struct
import subprocess
import tracemalloc
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from service.archive.avatar import Avatar
from service.archive.glb import glb_bytes
from service.archive.images import encode_png
from service.archive.obj import obj_bytes
from service.archive.pack import archive_members
from service.archive.surfaces import subdivided_head
from service.archive.usd import MOST_POINTS, curves_bytes
from service.errors import NumericFault
from service.hair.groom import make_groom
from service.hair.style import NAMED
from service.materials.part import head_parts, material_of
from tests.service.archive.toys import toy_avatar, toy_texture
from tests.tools.surfaces import accessor, gltf, values_of

TOOLS = Path(__file__).resolve().parents[2] / "tools"

Array = npt.NDArray[np.float64]


@dataclass
class Obj:
    """Plain reading of an OBJ file."""

    v: Array
    vt: Array
    vn: Array
    faces: list[list[tuple[int, int, int]]]
    material: list[str]
    objects: list[str]


def read_obj(data: bytes) -> Obj:
    rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    result = Obj(np.zeros(0), np.zeros(0), np.zeros(0), [], [], [])
    material = ""
    for line in data.decode("ascii").splitlines():
        key, *rest = line.split() or [""]
        if key in rows:
            rows[key].append([float(x) for x in rest])
        elif key == "f":
            result.faces.append([tuple(int(x) - 1 for x in corner.split("/")) for corner in rest])  # type: ignore[misc]
            result.material.append(material)
        elif key == "usemtl":
            material = rest[0]
        elif key == "o":
            result.objects.append(rest[0])
    result.v, result.vt, result.vn = (np.array(rows[key]) for key in ("v", "vt", "vn"))
    return result


@dataclass
class Glb:
    """Plain reading of a GLB file: JSON, buffer and accessors."""

    json: dict[str, Any]
    binary: bytes

    @classmethod
    def read(cls, data: bytes) -> Glb:
        assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
        return cls(*gltf(data))

    def accessor(self, index: int) -> npt.NDArray[Any]:
        told = self.json["accessors"][index]
        if "sparse" in told:
            rows = values_of(self.json, self.binary, told["sparse"]["indices"], told["sparse"]["count"], 1)
            assert (np.diff(rows[:, 0].astype(int)) > 0).all()
        values = accessor(self.json, self.binary, index)
        return values if told["componentType"] == 5126 else values.astype(int)


@pytest.fixture(scope="module")
def avatar() -> Avatar:
    return toy_avatar()


@pytest.fixture(scope="module")
def members(avatar: Avatar) -> dict[str, bytes]:
    return archive_members(avatar)


@pytest.fixture(scope="module")
def obj(members: dict[str, bytes]) -> Obj:
    return read_obj(members["mesh/head.obj"])


@pytest.fixture(scope="module")
def glb(members: dict[str, bytes]) -> Glb:
    return Glb.read(members["mesh/head.glb"])


def validator_report(data: bytes, folder: Path) -> dict[str, Any]:
    """Khronos' own judgement; skips where the tool is missing."""
    node = shutil.which("node")
    if node is None or not (TOOLS / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("the Khronos glTF validator is missing: install Node.js, then npm ci --prefix tests/tools")
    (folder / "head.glb").write_bytes(data)
    command = [node, str(TOOLS / "validate_glb.js"), str(folder / "head.glb")]
    report: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return report


def test_the_khronos_validator_is_awake(members: dict[str, bytes], tmp_path: Path) -> None:
    """The same file with its first vertex made NaN must not pass."""
    data = bytearray(members["mesh/head.glb"])
    (length,) = struct.unpack_from("<I", data, 12)
    content = json.loads(data[20 : 20 + length])
    accessor = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    start = 28 + length + content["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor["byteOffset"]
    struct.pack_into("<f", data, start, float("nan"))
    assert validator_report(bytes(data), tmp_path)["issues"]["numErrors"] > 0


def test_neutral_and_morphs_add_up_to_the_head(avatar: Avatar, glb: Glb) -> None:
    """Base plus weighted targets at every split vertex is head.shape(identity, expression)."""
    head = avatar.head
    weights = np.array([0.7, 0.2, 1.0, 0.5])
    wanted = head.shape(avatar.fit.identity, weights)
    for index, mesh in enumerate(glb.json["meshes"]):
        assert mesh["extras"]["targetNames"] == list(head.expression_names)
        assert mesh["weights"] == [0.0] * len(head.expression_names), "the file's own pose is neutral"
        primitive = mesh["primitives"][0]
        base = glb.accessor(primitive["attributes"]["POSITION"])
        targets = [glb.accessor(target["POSITION"]) for target in primitive["targets"]]
        posed = base + sum(w * t for w, t in zip(weights, targets, strict=True))
        triangles = glb.accessor(primitive["indices"]).reshape(-1, 3)
        chosen = head.triangles[head.triangle_part == index]
        np.testing.assert_allclose(base[triangles], avatar.fit.neutral[chosen], atol=1e-7)
        np.testing.assert_allclose(posed[triangles], wanted[chosen], atol=4e-6)


def test_bounds_and_winding(avatar: Avatar, glb: Glb) -> None:
    for mesh in glb.json["meshes"]:
        primitive = mesh["primitives"][0]
        points = glb.accessor(primitive["attributes"]["POSITION"])
        accessor = glb.json["accessors"][primitive["attributes"]["POSITION"]]
        np.testing.assert_array_equal(np.float32(accessor["min"]), points.min(0))
        np.testing.assert_array_equal(np.float32(accessor["max"]), points.max(0))
        triangles = glb.accessor(primitive["indices"]).reshape(-1, 3)
        a, b, c = (points[triangles[:, i]].astype(float) for i in range(3))
        normals = glb.accessor(primitive["attributes"]["NORMAL"])[triangles].mean(1)
        facing = (np.cross(b - a, c - a) * normals).sum(1)
        assert (facing > 0).all(), f"{mesh['name']}: a triangle is wound against its normal"


def test_parts_have_their_materials(avatar: Avatar, glb: Glb) -> None:
    names = [material["name"] for material in glb.json["materials"]]
    assert len(set(names)) == len(names)
    for mesh in glb.json["meshes"]:
        assert names[mesh["primitives"][0]["material"]] == material_of(mesh["name"]).name
    # Lash cards without a cut-out would look like a mask.
    assert "lashes" in avatar.head.part_names and "lashes" not in names
    assert "lashes" not in {mesh["name"] for mesh in glb.json["meshes"]}
    skin = glb.json["materials"][names.index("skin")]["pbrMetallicRoughness"]
    assert skin["baseColorTexture"] == {"index": 0} and skin["metallicFactor"] == 0


def test_a_marked_texel_lands_on_the_same_vertex_in_obj_and_glb(
    avatar: Avatar, obj: Obj, glb: Glb, members: dict[str, bytes]
) -> None:
    """v grows upwards in OBJ and downwards in glTF: both must read the same pixel of the same picture at a vertex."""
    head, neutral = avatar.head, avatar.fit.neutral
    height, width = avatar.texture.texture.shape[:2]
    rng = np.random.default_rng(0)
    for face in rng.choice(len(obj.faces), 40, replace=False):
        vertex, uv, _ = obj.faces[face][0]
        from_obj = (int(obj.vt[uv, 0] * width), int((1 - obj.vt[uv, 1]) * height))  # OBJ: origin bottom left
        part = int(head.polygon_part[np.flatnonzero((head.polygons == vertex).any(1))[0]])
        if head.part_names[part] == "lashes":
            continue  # not in the GLB
        primitive = glb.json["meshes"][part]["primitives"][0]
        here = np.abs(glb.accessor(primitive["attributes"]["POSITION"]) - neutral[vertex]).max(1) < 1e-9
        texture_points = glb.accessor(primitive["attributes"]["TEXCOORD_0"])[here]
        from_glb = {(int(u * width + 1e-4), int(v * height + 1e-4)) for u, v in texture_points}  # glTF: origin top left
        assert any(abs(x - from_obj[0]) <= 1 and abs(y - from_obj[1]) <= 1 for x, y in from_glb)
    flipped = 1 - obj.vt[:, 1]
    assert np.abs(flipped - obj.vt[:, 1]).mean() > 0.1, "the toy's chart would not show a flip"


def test_glb_refuses_nan_and_takes_a_head_without_blendshapes(avatar: Avatar, tmp_path: Path) -> None:

    picture = encode_png(toy_texture().texture, srgb=True)
    facts: dict[str, Any] = {"expression": {}, "head": "h", "licence": "CC0-1.0"}
    broken = avatar.fit.neutral.copy()
    broken[0, 0] = np.nan
    with pytest.raises(NumericFault):
        head_parts(avatar.head, avatar.fit.vertices, broken)
    still = replace(avatar.head, expression=avatar.head.expression[:0], expression_names=())
    parts = head_parts(still, avatar.fit.vertices, avatar.fit.neutral)
    content = Glb.read(glb_bytes(parts, {"diffuse_albedo": picture}, units=(), **facts)).json
    assert all("targets" not in mesh["primitives"][0] and "extras" not in mesh for mesh in content["meshes"])


def test_writing_a_fine_mesh_takes_little_more_memory_than_its_text(avatar: Avatar) -> None:
    """All numbers of a mesh as Python's took five times the text, at the moment of most memory of a run."""
    fine, points = subdivided_head(avatar.head, avatar.fit.vertices, steps=4)
    tracemalloc.start()
    try:
        text = obj_bytes(fine, points, "fine")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(text) > 10e6
    assert peak < 3.5 * len(text)


def test_usd_blendshapes_and_their_weights_give_the_photos_expression(
    avatar: Avatar, members: dict[str, bytes], tmp_path: Path
) -> None:
    """Baked by USD itself: blendshapes, and joints at rest that must not move anything."""
    pytest.importorskip("pxr", reason="USD is missing: pip install usd-core")
    Usd, UsdGeom, UsdSkel = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "UsdSkel"))
    (tmp_path / "head.usda").write_bytes(members["mesh/head.usda"])
    stage: Any = Usd.Stage.Open(str(tmp_path / "head.usda"))
    skeleton: Any = UsdSkel.Skeleton(stage.GetPrimAtPath("/Head/Skeleton"))
    assert list(skeleton.GetJointsAttr().Get()) == [
        "neck", "neck/head", "neck/head/jaw", "neck/head/eye_left", "neck/head/eye_right",
    ]  # fmt: skip
    animation: Any = UsdSkel.Animation(stage.GetPrimAtPath("/Head/Skeleton/Animation"))
    assert list(animation.GetBlendShapesAttr().Get()) == list(avatar.head.expression_names)
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/Head")))
    for index, name in enumerate(avatar.head.part_names):
        own = np.unique(avatar.head.triangles[avatar.head.triangle_part == index])
        points = np.array(UsdGeom.Mesh.Get(stage, f"/Head/{name}").GetPointsAttr().Get())
        np.testing.assert_allclose(points, avatar.fit.vertices[own], atol=5e-6)


def test_usd_opens_and_says_the_same(avatar: Avatar, members: dict[str, bytes], tmp_path: Path) -> None:
    usd: Any = pytest.importorskip("pxr", reason="USD is missing: pip install usd-core")
    modules: list[Any] = [importlib.import_module(f"{usd.__name__}.{name}") for name in ("Usd", "UsdGeom", "UsdShade")]
    Usd, UsdGeom, UsdShade = modules
    for name in ("mesh/head.usda", "maps/texture.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(members[name])
    stage = Usd.Stage.Open(str(tmp_path / "mesh" / "head.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetDefaultPrim().GetName() == "Head"
    head = avatar.head
    for index, name in enumerate(head.part_names):
        mesh = UsdGeom.Mesh.Get(stage, f"/Head/{name}")
        polygons = head.polygons[head.polygon_part == index]
        flat_uv = head.polygon_uv[head.polygon_part == index]
        points, corners = np.array(mesh.GetPointsAttr().Get()), np.array(mesh.GetFaceVertexIndicesAttr().Get())
        assert UsdGeom.Mesh.ValidateTopology(corners.tolist(), mesh.GetFaceVertexCountsAttr().Get(), len(points))[0]
        np.testing.assert_allclose(points[corners], avatar.fit.neutral[polygons[polygons >= 0]], atol=1e-6)
        st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
        assert st.GetInterpolation() == "faceVarying" and len(st.Get()) <= len(head.uv)
        np.testing.assert_allclose(np.array(st.ComputeFlattened()), head.uv[flat_uv[flat_uv >= 0]], atol=6e-6)
        bound = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
        assert bound.GetPrim().GetName() == material_of(name).name
    file = UsdShade.Shader.Get(stage, "/Head/Materials/skin/Colour").GetInput("file").Get()
    assert Path(file.resolvedPath).resolve() == (tmp_path / "maps" / "texture.png").resolve()


@pytest.mark.parametrize("kind", ["bob", "afro"])
def test_usd_reads_the_strands(kind: str) -> None:
    pxr = pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom

    assert pxr
    groom = make_groom(NAMED[kind], 3, 400)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(curves_bytes(groom, "hair").decode())
    stage = Usd.Stage.Open(layer)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    curves = UsdGeom.BasisCurves(stage.GetDefaultPrim())
    counts = np.array(curves.GetCurveVertexCountsAttr().Get())
    points = np.array(curves.GetPointsAttr().Get()).reshape(len(groom), -1, 3)
    assert len(counts) == len(groom)
    assert (counts == points.shape[1]).all()
    assert points.shape[1] == min(groom.strands.shape[1], MOST_POINTS)
    assert np.allclose(points[:, 0], groom.strands[:, 0], atol=1e-5)
    assert np.allclose(points[:, -1], groom.strands[:, -1], atol=1e-5)
    widths = np.array(curves.GetWidthsAttr().Get())
    assert len(widths) == points.shape[0] * points.shape[1]
    assert 2e-5 < widths.min() < widths.max() < 1.2e-4
    colour = np.array(curves.GetDisplayColorAttr().Get()).reshape(*points.shape[:2], 3)
    assert np.allclose(colour, groom.colour.linear(points.shape[1]), atol=1e-3)
    assert curves.GetWidthsInterpolation() == UsdGeom.Tokens.vertex
    groom.strands[0, 0, 0] = np.nan  # JSON writes it as null, which no reader of USD takes
    with pytest.raises(NumericFault):
        curves_bytes(groom, "hair")
