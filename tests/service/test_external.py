"""A head of one's own: what mesh and texture have to be, and what the archive says."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from models.head.writing import save_head
from service.archive.images import encode_png
from service.archive.obj import obj_bytes, read_obj
from service.archive.pack import archive_members
from service.cli.app import app
from service.errors import BadAspect, BadMesh
from service.external import check_aspect, make_external, mesh_type, vertices_of
from service.manifest import json_schema
from service.options import Options
from tests.toyhead import sphere_head

HEAD = sphere_head(16, 24)
MESH = obj_bytes(HEAD, HEAD.mean, "toy")
TEXTURE = encode_png(np.random.default_rng(2).integers(60, 200, (64, 96, 3), np.uint8), srgb=True)


@pytest.fixture(scope="module")
def head_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("head") / "head.npz"
    save_head(HEAD, path)
    return path


def test_the_mesh_of_an_archive_comes_back() -> None:
    np.testing.assert_allclose(vertices_of(MESH, "obj", HEAD), HEAD.mean, atol=1e-6)


@pytest.mark.parametrize("kind", ["glb", "ply", "obj"])
def test_other_programs_write_meshes_in_their_own_way(kind: str) -> None:
    """Sculpted, in another order, split along seams and into triangles, in a format of theirs."""
    scene = trimesh.load_scene(io.BytesIO(MESH), file_type="obj", process=False)
    meshes: list[Any] = list(scene.geometry.values())
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    charts = np.concatenate([mesh.visual.uv for mesh in meshes])
    triangles = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    order = np.random.default_rng(1).permutation(len(vertices))
    moved = (vertices * [1.1, 1.0, 0.9])[order]
    faces = np.roll(np.argsort(order)[triangles][np.random.default_rng(2).permutation(len(triangles))], 1, 1)
    uv = trimesh.visual.TextureVisuals(uv=charts[order])  # type: ignore[no-untyped-call]
    data = trimesh.Trimesh(moved, faces, visual=uv, process=False).export(file_type=kind)
    data = data.encode() if isinstance(data, str) else data
    assert isinstance(data, bytes)
    assert mesh_type(f"x.{kind}", b"") == mesh_type("-", data) == kind
    np.testing.assert_allclose(vertices_of(data, kind, HEAD), HEAD.mean * np.array([1.1, 1.0, 0.9]), atol=1e-5)


def changed(pattern: str, change: Callable[[list[str]], list[str]]) -> bytes:
    """The mesh with the lines that begin with a word changed."""
    lines = MESH.decode().splitlines()
    return "\n".join(" ".join(change(line.split())) if line.startswith(pattern) else line for line in lines).encode()


def test_other_topologies_are_refused_and_told_apart() -> None:
    text = MESH.decode()
    faces = [line for line in text.splitlines() if line.startswith("f ")]
    for data, words in (
        (text.replace(faces[3] + "\n", "").replace(faces[70] + "\n", "").encode(), "other faces|lacks"),
        (changed("vt ", lambda w: ["vt", *(f"{float(x) * 0.9 + 0.1:.6f}" for x in w[1:])]), r"differ.*0\.\d"),
        (changed("f ", lambda w: ["f", *(x.split("/")[0] for x in w[1:])]), "without texture coordinates"),
        (changed("v ", lambda w: ["v", *(str(float(x) * 100) for x in w[1:])]), "metres"),
        (changed("v ", lambda w: ["v", "nan", *w[2:]]), "not finite|cannot be read"),
        (b"", "faces|cannot be read"),
        (b"\xff\xfe\x00", "faces|cannot be read"),
    ):
        with pytest.raises(BadMesh, match=words):
            vertices_of(data, "obj", HEAD)
    with pytest.raises(BadMesh, match="cannot be read as FBX"):
        vertices_of(MESH, "fbx", HEAD)


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
    np.testing.assert_allclose(read_obj(members["mesh/head.obj"]).vertices, HEAD.mean, atol=1e-6)
    assert archive_members(
        make_external(TEXTURE, MESH, Options(maps=maps, quality="draft", size=(96, 64)), head_file=head_file)
    ) == members  # fmt: skip


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


def test_the_networks_run_as_for_a_photo(head_file: Path) -> None:
    options = Options(maps=("diffuse_albedo", "specular_albedo"), quality="draft", size=(96, 64))
    made = make_external(TEXTURE, MESH, options, head_file=head_file).reflectance
    assert made is not None and made.diffuse_albedo is not None and made.specular_albedo is not None
    assert made.diffuse_albedo.shape == (64, 96, 3)
    assert np.ptp(made.diffuse_albedo.astype(int)) > 1000
