"""A part beside the head's own reaches every file, and the part that it replaces is in none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.archive.pack import archive_members
from service.materials.material import Material
from service.materials.part import part_normals
from tests.service.archive.test_meshes import Glb, read_obj, validator_report
from tests.service.archive.toys import toy_avatar, toy_part


@pytest.fixture(scope="module")
def members() -> dict[str, bytes]:
    return archive_members(toy_avatar(parts=(toy_part(),)))


def test_obj_has_it_beside_the_whole_head(members: dict[str, bytes]) -> None:
    """Whoever looks for the head's surface must not meet hair, and its topology is that of every archive."""
    avatar, part = toy_avatar(), toy_part()
    own = read_obj(members["mesh/head.obj"])
    assert own.objects == list(avatar.head.part_names)
    np.testing.assert_allclose(own.v, avatar.fit.vertices, atol=6e-7)
    obj = read_obj(members["mesh/parts.obj"])
    assert obj.objects == ["toy_hair"] and len(obj.v) == len(part.vertices)
    quad, triangle = obj.faces[-2:]
    np.testing.assert_allclose(obj.v[[corner[0] for corner in quad]], part.vertices[part.faces[0]], atol=6e-7)
    np.testing.assert_allclose(obj.vt[[corner[1] for corner in triangle]], part.uv[part.faces[1, :3]], atol=6e-6)
    assert obj.material[-1] == "toy_hair" and len(triangle) == 3
    cards = part_normals(part, part.vertices, np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4]]))
    np.testing.assert_allclose(obj.vn[[corner[2] for corner in quad]], cards[part.faces[0]], atol=6e-3)
    plain = toy_avatar(parts=(toy_part(material=Material("toy_hair", (0.9, 0.8, 0.7))),))
    solid = read_obj(archive_members(plain)["mesh/parts.obj"])
    assert not len(solid.vn) and {len(corner) for corner in solid.faces[0]} == {2}, "smoothing groups stand for normals"
    material = members["mesh/head.mtl"].decode().split("newmtl toy_hair\n")[1]
    assert "map_Kd ../maps/parts/toy_hair.png" in material


def test_glb_has_it_with_alpha_and_targets(members: dict[str, bytes], tmp_path: Path) -> None:
    glb, part = Glb.read(members["mesh/head.glb"]), toy_part()
    names = [mesh["name"] for mesh in glb.json["meshes"]]
    assert names[-1] == "toy_hair" and "lashes" not in names
    mesh = glb.json["meshes"][-1]
    primitive = mesh["primitives"][0]
    assert mesh["extras"]["targetNames"] == glb.json["meshes"][0]["extras"]["targetNames"]
    base = glb.accessor(primitive["attributes"]["POSITION"])
    jaw = glb.accessor(primitive["targets"][mesh["extras"]["targetNames"].index("jawOpen")]["POSITION"])
    triangles = glb.accessor(primitive["indices"]).reshape(-1, 3)
    np.testing.assert_allclose(base[triangles][0], part.neutral[[0, 1, 2]], atol=1e-7)
    np.testing.assert_allclose(jaw, np.tile(part.targets["jawOpen"][0], (len(base), 1)), atol=1e-7)
    on_chart = {one["name"] for one in glb.json["materials"] if one.get("extras") == {"chart": True}}
    assert on_chart == {"skin", "eye", "teeth", "tongue"} & {one["name"] for one in glb.json["materials"]}
    material = glb.json["materials"][primitive["material"]]
    assert (material["alphaMode"], material["alphaCutoff"], material["doubleSided"]) == ("MASK", 0.4, True)
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == 0.3
    assert "baseColorFactor" not in material["pbrMetallicRoughness"]
    assert material["extensions"]["KHR_materials_ior"] == {"ior": 1.55}
    plain = toy_avatar(parts=(toy_part(material=Material("toy_hair", (0.9, 0.8, 0.7))),))
    materials = Glb.read(archive_members(plain)["mesh/head.glb"]).json["materials"]
    own = next(one for one in materials if one["name"] == "toy_hair")
    assert own["pbrMetallicRoughness"]["baseColorFactor"] == [0.9, 0.8, 0.7, 1.0]
    issues = validator_report(members["mesh/head.glb"], tmp_path)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
