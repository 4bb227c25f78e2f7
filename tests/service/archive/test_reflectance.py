"""Reflectance in the archive: maps, their codings, materials, the displaced mesh."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import trimesh

from service.archive.avatar import Avatar
from service.archive.container import MEMBERS
from service.archive.maps import COARSEST_STEP
from service.archive.pack import archive_members
from service.archive.surfaces import displaced, heights_at, subdivided_head
from service.geometry.mesh import face_normals
from service.map_registry import MAP_NAMES
from service.reflectance.reflectance_maps import MID, SCALE_MM, unpack_normals
from tests.service.archive.test_meshes import Glb
from tests.service.archive.toys import REFLECTANCE_SIZE, toy_avatar, toy_head, toy_reflectance
from tests.toyhead import CENTRE

SIZE = REFLECTANCE_SIZE
Image = npt.NDArray[Any]


def avatar(**options: Any) -> Avatar:
    asked = {"maps": list(MAP_NAMES), "quality": "standard", "bits": None, "normals": "tangent"} | options
    return toy_avatar(options=asked, reflectance=toy_reflectance())


def decode(data: bytes) -> Image:
    image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    return image if image.ndim == 2 else image[..., ::-1]


@pytest.fixture(scope="module")
def members() -> dict[str, bytes]:
    return archive_members(avatar())


@pytest.fixture(scope="module")
def fine_members() -> dict[str, bytes]:
    return archive_members(avatar(quality="high"))


def values(members: dict[str, bytes], role: str) -> Image:
    """What a reader gets who decodes a map as the manifest says."""
    coding = {entry["role"]: entry["coding"] for entry in json.loads(members["manifest.json"])["maps"]}[role]
    codes = decode(members[f"maps/{role}.png"]).astype(np.float64)
    return np.asarray((codes - coding["zero"]) / coding["scale"])


@pytest.mark.parametrize("bits", [8, 16])
def test_maps_decode_to_what_was_made(bits: int, members: dict[str, bytes], fine_members: dict[str, bytes]) -> None:
    made, files = toy_reflectance(), members if bits == 8 else fine_members
    assert made.diffuse_albedo is not None and made.specular_albedo is not None and made.displacement is not None
    half = 0.5 / 255 + 1e-6
    np.testing.assert_allclose(values(files, "diffuse_albedo"), made.diffuse_albedo / 65535, atol=half)
    np.testing.assert_allclose(values(files, "specular_albedo"), made.specular_albedo / 65535, atol=half)
    heights, whole = values(files, "displacement"), (made.displacement.astype(float) - MID) * SCALE_MM
    np.testing.assert_allclose(heights, whole, atol=COARSEST_STEP / 2 * SCALE_MM + 1e-9)
    assert len(np.unique(np.rint(heights / SCALE_MM) % COARSEST_STEP)) == 1, "in steps that compress well"
    step = 0.5 / 127 + 1e-4 if bits == 8 else 3e-5
    for role, normals in (("specular_normal", made.specular_normal), ("diffuse_normal", made.diffuse_normal)):
        assert normals is not None
        np.testing.assert_allclose(values(files, role), unpack_normals(normals), atol=step)


def test_object_space_normals_of_a_sphere_point_away_from_its_centre() -> None:
    """Flat tangent-space normals are the mesh's own normals in object space."""
    flat = replace(toy_reflectance(), specular_normal=np.zeros((*SIZE[::-1], 2), np.int16))
    asked = {"maps": ["specular_normal"], "normals": "object", "bits": 16}
    toy = toy_avatar(options=asked, reflectance=flat)
    head = toy.head
    round_head = replace(toy, fit=replace(toy.fit, vertices=head.mean))
    files = archive_members(round_head)
    manifest = json.loads(files["manifest.json"])
    assert [(entry["role"], entry["frame"]) for entry in manifest["maps"]] == [("specular_normal", "object")]
    from service.geometry.chart import Chart

    chart = Chart.build(head, *SIZE)
    skin = chart.part == 0
    outward = chart.interpolate(head.mean)[skin] - CENTRE
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.median(np.einsum("ni,ni->n", values(files, "specular_normal")[skin], outward)) > 0.99
    assert b"norm " not in files["mesh/head.mtl"], "object-space normals are not what a material wants"


def test_materials_lead_to_files_of_the_archive(members: dict[str, bytes]) -> None:
    lines = members["mesh/head.mtl"].decode().splitlines()
    named = {line.split()[-1] for line in lines if line.startswith(("map_", "norm "))}
    paths = {name.removeprefix("../") if name.startswith("../") else f"mesh/{name}" for name in named}
    assert paths == {"maps/diffuse_albedo.png", "mesh/specular_normal.exr", "mesh/specular_albedo.exr"}
    assert "map_Bump -bm 1 specular_normal.exr" in lines, "Blender ignores norm"
    assert paths <= set(members)


def test_the_glb_shows_the_maps_on_the_skin_only(members: dict[str, bytes]) -> None:
    glb, made = Glb.read(members["mesh/head.glb"]), toy_reflectance()
    names = [texture["name"] for texture in glb.json["textures"]]
    assert names == ["diffuse_albedo", "specular_normal", "specular_albedo"]
    skin = next(material for material in glb.json["materials"] if material["name"] == "skin")
    assert names[skin["normalTexture"]["index"]] == "specular_normal"
    specular = skin["extensions"]["KHR_materials_specular"]["specularTexture"]["index"]
    assert names[specular] == "specular_albedo" and glb.json["extensionsUsed"] == ["KHR_materials_specular"]
    assert sum("normalTexture" in material for material in glb.json["materials"]) == 1
    views = [glb.json["bufferViews"][image["bufferView"]] for image in glb.json["images"]]
    colour, normal, rgba = (decode(glb.binary[view["byteOffset"] :][: view["byteLength"]]) for view in views)
    assert made.diffuse_albedo is not None and made.specular_normal is not None and made.specular_albedo is not None
    # JPEG, of noise here.
    assert np.abs(colour.astype(int) - made.diffuse_albedo // 257).mean() < 8
    np.testing.assert_allclose(normal / 127.5 - 1, unpack_normals(made.specular_normal), atol=0.01)
    alpha = rgba[..., 0]  # OpenCV's order, turned round
    np.testing.assert_allclose(alpha / 255, made.specular_albedo / 65535, atol=0.5 / 255 + 1e-6)


def test_tangents_point_along_u_and_the_bitangent_up_the_chart(members: dict[str, bytes]) -> None:
    """On the sphere u runs east and v north; a flipped sign would turn every pore inside out."""
    glb = Glb.read(members["mesh/head.glb"])
    assert sum("TANGENT" in mesh["primitives"][0]["attributes"] for mesh in glb.json["meshes"]) == 1
    skin = glb.json["meshes"][0]["primitives"][0]["attributes"]
    position, normal, tangent = (glb.accessor(skin[name]) for name in ("POSITION", "NORMAL", "TANGENT"))
    np.testing.assert_allclose(np.linalg.norm(tangent[:, :3], axis=1), 1, atol=1e-4)
    np.testing.assert_allclose(np.einsum("ni,ni->n", tangent[:, :3], normal), 0, atol=1e-4)
    assert (tangent[:, 3] == 1).all()
    away = position - CENTRE
    middle = np.hypot(away[:, 0], away[:, 2]) > 0.5 * np.linalg.norm(away, axis=1)
    east = np.stack([away[:, 2], np.zeros(len(away)), -away[:, 0]], 1)[middle]
    assert (np.einsum("ni,ni->n", tangent[middle, :3], east) > 0).all()
    assert (np.cross(normal, tangent[:, :3])[middle, 1] > 0).all()


def test_the_fine_mesh_comes_with_high_quality(members: dict[str, bytes], fine_members: dict[str, bytes]) -> None:
    assert "mesh/head_fine.obj" not in members
    data = fine_members["mesh/head_fine.obj"]
    coarse = members["mesh/head.obj"].count(b"\nf ")
    assert data.count(b"\nf ") > 50 * coarse
    mesh = cast(trimesh.Trimesh, trimesh.load(io.BytesIO(data), file_type="obj", process=False, force="mesh"))
    assert len(mesh.faces) == 2 * data.count(b"\nf ")
    assert np.ptp(mesh.vertices, axis=0).max() < 0.3, "metres"
    assert list(fine_members) and set(fine_members) <= set(MEMBERS)


def test_embossing_moves_along_the_normal_by_millimetres() -> None:
    head = toy_head()
    fine, points = subdivided_head(head, head.mean, steps=2)
    raised = displaced(fine, points, np.full((64, 96), MID + round(0.5 / SCALE_MM), np.uint16))
    skin = np.unique(fine.triangles[fine.triangle_part == 0])
    np.testing.assert_allclose(np.linalg.norm((raised - points)[skin], axis=1), 0.5e-3, rtol=1e-3)
    assert (np.linalg.norm(raised[skin] - CENTRE, axis=1) > np.linalg.norm(points[skin] - CENTRE, axis=1)).all()


def test_no_triangle_is_turned_over_however_wild_the_relief() -> None:
    """Noise of a millimetre at every texel on triangles of the same size: unguarded, many turn over."""
    head = toy_head()
    fine, points = subdivided_head(head, head.mean * np.float32(0.05), steps=2)
    wild = np.random.default_rng(0).choice([MID - 20000, MID + 20000], (512, 768)).astype(np.uint16)
    before = face_normals(points, fine.triangles)
    after = face_normals(displaced(fine, points, wild), fine.triangles)
    assert (np.einsum("ti,ti->t", before, after) >= 0).all()
    from service.geometry.mesh import area_normals

    plain = points + 1e-3 * heights_at(fine, wild)[:, None] * area_normals(points, fine.triangles)
    assert (np.einsum("ti,ti->t", before, face_normals(plain, fine.triangles)) < 0).any(), "the test is too easy"


def test_heights_are_read_at_the_right_place() -> None:
    """A map that grows along u and v gives each vertex its own chart coordinate."""
    head = toy_head()
    fine, _ = subdivided_head(head, head.mean, steps=1)
    row, column = np.mgrid[:64, :96]
    ramp = np.rint(1000 * (column + 0.5) / 96 + 20000 * (1 - (row + 0.5) / 64)).astype(np.uint16)
    found = heights_at(fine, ramp) / SCALE_MM + MID
    inside = fine.polygon_part == 1
    vertex, place = fine.polygons[inside].ravel(), fine.polygon_uv[inside].ravel()
    single = np.bincount(np.unique(np.stack([vertex, place], 1), axis=0)[:, 0], minlength=len(fine.mean)) == 1
    expected = fine.uv[place] @ [1000, 20000]
    np.testing.assert_allclose(found[vertex][single[vertex]], expected[single[vertex]], atol=15)
