"""A head of one's own: what mesh and texture have to be, and what the archive says."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

from service.archive.images import encode_png
from service.archive.manifest import from_json, json_schema
from service.archive.obj import obj_bytes
from service.archive.pack import archive_members
from service.archive.read_obj import ObjMesh, read_obj
from service.cli.app import app
from service.errors import BadAspect, BadMesh, UnreadableInput, UsageError
from service.external import check_aspect, default_maps, make_external, vertices_of
from service.head.files import save_head
from service.options import Options
from service.reflectance.reflectance_maps import Reflectance
from service.reflectance.reflectance_plan import ReflectancePlan
from service.reflectance.subject import Subject
from tests.toyhead import sphere_head

HEAD = sphere_head(16, 24)
MESH = obj_bytes(HEAD, HEAD.mean, "toy")
TEXTURE = encode_png(np.random.default_rng(2).integers(60, 200, (64, 96, 3), np.uint8), srgb=True)


@pytest.fixture(scope="module")
def head_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("head") / "head.npz"
    save_head(HEAD, path)
    return path


def mesh(**changes: object) -> ObjMesh:
    return dataclasses.replace(read_obj(MESH), **changes)  # type: ignore[arg-type]


def test_the_mesh_of_an_archive_comes_back() -> None:
    np.testing.assert_allclose(vertices_of(read_obj(MESH), HEAD), HEAD.mean, atol=1e-6)


def test_a_sculpted_mesh_keeps_its_shape() -> None:
    moved = read_obj(MESH).vertices * [1.1, 1.0, 0.9]
    np.testing.assert_allclose(vertices_of(mesh(vertices=moved), HEAD), moved, atol=1e-6)


def test_order_and_first_corner_of_faces_do_not_matter() -> None:
    """Other programs write faces in their own order, begin elsewhere, and split quads along either diagonal."""
    plain = read_obj(MESH)
    order = np.random.default_rng(1).permutation(len(plain.polygons))
    turned, turned_uv = plain.polygons[order].copy(), plain.polygon_uv[order].copy()
    quad = turned[:, 3] >= 0
    turned[quad], turned_uv[quad] = np.roll(turned[quad], 1, 1), np.roll(turned_uv[quad], 1, 1)
    again = mesh(polygons=turned, polygon_uv=turned_uv, polygon_part=plain.polygon_part[order])
    np.testing.assert_allclose(vertices_of(again, HEAD), HEAD.mean, atol=1e-6)
    for corners in (([0, 1, 2], [0, 2, 3]), ([0, 1, 3], [1, 2, 3])):
        split, split_uv = (
            np.concatenate([np.column_stack([a[quad][:, c], np.full(quad.sum(), -1)]) for c in corners]
                           + [a[~quad]]).astype(np.int32) for a in (turned, turned_uv)
        )  # fmt: skip
        triangles = mesh(polygons=split, polygon_uv=split_uv, polygon_part=np.zeros(len(split), np.uint8))
        np.testing.assert_allclose(vertices_of(triangles, HEAD), HEAD.mean, atol=1e-6)


def test_other_topologies_are_refused_and_told_apart() -> None:
    plain = read_obj(MESH)
    with pytest.raises(BadMesh, match="vertices, the head model"):
        vertices_of(mesh(vertices=plain.vertices[:-1]), HEAD)
    with pytest.raises(BadMesh, match="edges are missing"):
        vertices_of(
            mesh(polygons=plain.polygons[:-3], polygon_uv=plain.polygon_uv[:-3], polygon_part=plain.polygon_part[:-3]),
            HEAD,
        )
    swapped = plain.polygons.copy()
    swapped[swapped == 40], swapped[plain.polygons == 90] = 90, 40  # as many vertices, in another order
    with pytest.raises(BadMesh, match="other faces"):
        vertices_of(mesh(polygons=swapped), HEAD)
    with pytest.raises(BadMesh, match=r"texture coordinates differ.*0\.09"):
        vertices_of(mesh(uv=plain.uv * 0.9 + 0.1), HEAD)
    with pytest.raises(BadMesh, match="without texture coordinates"):
        vertices_of(mesh(polygon_uv=np.full_like(plain.polygon_uv, -1)), HEAD)
    with pytest.raises(BadMesh, match="metres"):
        vertices_of(mesh(vertices=plain.vertices * 100.0), HEAD)


@pytest.mark.parametrize(("width", "height"), [(96, 96), (100, 64), (64, 96), (6144, 4000)])
def test_textures_of_another_shape_are_refused(width: int, height: int) -> None:
    with pytest.raises(BadAspect, match="3:2"):
        check_aspect(width, height)
    check_aspect(96, 64)
    check_aspect(1000, 667)


def test_the_archive_says_that_there_was_no_photo(head_file: Path) -> None:
    maps = ("texture", "shape_normal")
    avatar = make_external(TEXTURE, MESH, Options(maps=maps, quality="draft", size=(96, 64)), head_file=head_file)
    members = archive_members(avatar)
    manifest = json.loads(members["manifest.json"])
    jsonschema.validate(manifest, json_schema())
    assert manifest["camera"] is manifest["input"] is manifest["fit"] is None
    assert manifest["given"]["width"] == 96 and len(manifest["given"]["mesh_sha256"]) == 64
    assert [item["role"] for item in manifest["maps"]] == list(maps)
    assert "preview/overlay.jpg" not in members and "preview/sheet.jpg" in members
    assert {card["name"] for card in manifest["models"]} == {"toy sphere"}
    assert "face" not in manifest["options"]
    assert b"photo shows" not in members["LICENSES.md"] and b"that you gave" in members["LICENSES.md"]
    assert from_json(members["manifest.json"]).given is not None
    np.testing.assert_allclose(read_obj(members["mesh/head.obj"]).vertices, HEAD.mean, atol=1e-6)
    assert archive_members(
        make_external(TEXTURE, MESH, Options(maps=maps, quality="draft", size=(96, 64)), head_file=head_file)
    ) == members  # fmt: skip


def test_the_networks_run_as_for_a_photo(head_file: Path) -> None:
    options = Options(maps=("diffuse_albedo", "specular_albedo"), quality="draft", size=(96, 64))
    made = make_external(TEXTURE, MESH, options, head_file=head_file).reflectance
    assert made is not None and made.diffuse_albedo is not None and made.specular_albedo is not None
    assert made.diffuse_albedo.shape == (64, 96, 3)
    assert np.ptp(made.diffuse_albedo.astype(int)) > 1000


def test_a_finer_texture_keeps_its_detail(head_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not brought down to the size that the enlarging network takes, and that network does not run."""
    stripes = np.zeros((800, 1200, 3), np.uint8)
    stripes[:, ::4] = 255
    seen = {}

    def reflectance(
        texture: np.ndarray, subject: Subject, plan: ReflectancePlan, size: object, *_: object, **__: object
    ) -> object:
        seen[texture.shape[1]] = (plan.stages, float(texture.std()))
        return Reflectance((1536, 1024))

    monkeypatch.setattr("service.external.make_reflectance", reflectance)
    options = Options(maps=("diffuse_albedo",), quality="standard")
    for width, picture in ((1200, stripes), (576, stripes[:384, :576])):
        make_external(encode_png(picture, srgb=True), MESH, options, head_file=head_file)
        stages, contrast = seen[width]
        assert ("super_resolution" in stages) == (width == 576)
        assert contrast > 80


def test_what_only_a_photo_gives_cannot_be_asked_for(head_file: Path) -> None:
    assert "confidence" not in default_maps()
    with pytest.raises(UsageError, match="confidence"):
        make_external(TEXTURE, MESH, Options(maps=("confidence",)), head_file=head_file)


@pytest.mark.parametrize("texture", [b"", b"nonsense", TEXTURE[:200]])
def test_textures_go_through_the_gate(texture: bytes, head_file: Path) -> None:
    with pytest.raises(UnreadableInput):
        make_external(texture, MESH, Options(maps=("texture",)), head_file=head_file)


def test_the_command(tmp_path: Path, head_file: Path) -> None:
    (tmp_path / "t.png").write_bytes(TEXTURE)
    (tmp_path / "h.obj").write_bytes(MESH)
    out = tmp_path / "own.zip"
    command = [
        "maps", "--texture", str(tmp_path / "t.png"), "--mesh", str(tmp_path / "h.obj"), "-o", str(out), "--maps",
        "texture", "--size", "96x64", "--quality", "draft", "--head", str(head_file), "--json",
    ]  # fmt: skip
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout.splitlines()[-1])
    assert facts["archive"] == str(out) and facts["options"]["maps"] == ["texture"]
    assert zipfile.ZipFile(io.BytesIO(out.read_bytes())).testzip() is None
    wrong = CliRunner().invoke(app, [*command[:2], str(tmp_path / "h.obj"), *command[3:]])
    assert wrong.exit_code == 4
    assert json.loads(wrong.stdout.splitlines()[-1])["error"]["code"] == "unsupported-format"
    both = CliRunner().invoke(app, ["maps", "--texture", "-", "--mesh", "-", "-o", str(out)])
    assert both.exit_code == 2
