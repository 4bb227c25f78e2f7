"""Kits of a whole archive: what they hold opens, says the same as the archive, and is in the packing of the tool.

Levels of detail of hair; those of the head are tested with the kits.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from service.archive.avatar import drawn_parts
from service.archive.pack import write_archive
from service.cli.app import app
from service.errors import BadArchive, UsageError
from service.hair.cards import Budget, hair_parts
from service.hair.groom import make_groom
from service.hair.scalp import mean_scalp
from service.hair.style import NAMED
from service.kits import export as blender
from service.kits.engines import reduced, triangles
from service.kits.export import export_kit
from service.kits.source import materials_of, opened, read_parts
from service.materials.material import OwnMap
from service.materials.part import head_parts
from tests.service.archive.test_meshes import Glb, validator_report
from tests.service.archive.toys import toy_part, whole_avatar


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kits") / "toy.zip"
    write_archive(whole_avatar(), path)
    return path


def pixels(path: Path) -> npt.NDArray[np.uint8]:
    image = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.uint8)
    return image if image.ndim == 2 else image[..., [2, 1, 0, *range(3, image.shape[2])]]


def test_usd_and_manifest_are_read_back_as_the_parts(archive: Path) -> None:
    source = opened(archive)
    materials = materials_of(source)
    read = read_parts(source.read("mesh/head.usda"), source.manifest, materials)
    wanted = drawn_parts(whole_avatar())
    assert [part.name for part in read] == [part.name for part in wanted]
    for part, true in zip(read, wanted, strict=True):
        np.testing.assert_allclose(part.neutral, true.neutral, atol=1e-6)
        np.testing.assert_array_equal(part.polygons, true.polygons)
        present = part.polygons >= 0
        np.testing.assert_allclose(part.uv[part.polygons_uv[present]], true.uv[true.polygons_uv[present]], atol=6e-6)
        assert part.bone == true.bone
        for unit, offsets in true.targets.items():
            np.testing.assert_allclose(part.targets.get(unit, 0 * offsets), offsets, atol=2.6e-5)
        a, b = part.material, true.material
        assert (a.name, a.colour, a.alpha, a.cutoff, a.ior, a.roughness) == (
            b.name, b.colour, b.alpha, b.cutoff, b.ior, b.roughness,
        )  # fmt: skip
    hair = read[-1].material.colour_map
    assert isinstance(hair, OwnMap)
    np.testing.assert_array_equal(hair.pixels, toy_part().own_maps[0].pixels)


def test_a_cut_usd_is_refused(archive: Path) -> None:
    source = opened(archive)
    data = source.read("mesh/head.usda")
    with pytest.raises(BadArchive, match=r"head\.usda"):
        read_parts(data[: len(data) // 2], source.manifest, materials_of(source))


def test_reduced_parts_keep_vertices_uv_and_blendshapes() -> None:
    avatar = whole_avatar()
    skin = head_parts(avatar.head, avatar.fit.neutral, avatar.fit.neutral)[0]
    (few,) = reduced(skin, [0.4])
    assert 0.3 * triangles(skin) < triangles(few) < 0.5 * triangles(skin)
    distance = np.linalg.norm(few.neutral[:, None] - skin.neutral[None], axis=2)
    nearest = distance.argmin(1)
    assert distance.min(1).max() == 0, "a subset of the vertices"
    np.testing.assert_array_equal(few.targets["jawOpen"], skin.targets["jawOpen"][nearest])
    places = {tuple(np.round(row, 6)) for row in skin.uv.tolist()}
    assert {tuple(np.round(row, 6)) for row in few.uv.tolist()} <= places
    assert [triangles(one) for one in reduced(skin, [1.0])] == [triangles(skin)]


def test_reduced_cards_keep_the_normals_of_the_body_that_they_make_up() -> None:
    """Kits of heads with hair failed: fewer vertices, and all normals."""
    rows, columns = np.mgrid[0:12, 0:12]
    points = np.stack([columns.ravel(), rows.ravel(), 0 * rows.ravel()], 1).astype(np.float32) * np.float32(0.01)
    corner = (rows[:-1, :-1] * 12 + columns[:-1, :-1]).ravel()
    faces = np.stack([corner, corner + 1, corner + 13, corner + 12], 1).astype(np.int32)
    away = points + np.array([0, 0, 0.1], np.float32)
    normals = away / np.linalg.norm(away, axis=1, keepdims=True)
    uv = (points[:, :2] / np.float32(0.11)).astype(np.float32)
    cards = toy_part(vertices=points, neutral=points, faces=faces, uv=uv, uv_faces=faces, targets={}, normals=normals)
    (few,) = reduced(cards, [0.4])
    assert few.normals is not None and len(few.normals) == len(few.neutral) < len(points)
    away = few.neutral + np.array([0, 0, 0.1], np.float32)
    np.testing.assert_allclose(few.normals, away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-5)


@pytest.mark.parametrize(("tool", "up"), [("unreal", False), ("unity", True), ("maya", True)])
def test_an_engines_kit(archive: Path, tool: str, up: bool, tmp_path: Path) -> None:
    kit = export_kit(archive, tool, tmp_path / "kit")
    facts = json.loads((kit.folder / "kit.json").read_text())
    flags = {one["file"]: one["srgb"] for one in facts["textures"]}
    assert flags["textures/head_basecolor.png"] and sum(flags.values()) == 1
    for name in flags:
        height, width = pixels(kit.folder / name).shape[:2]
        assert height == width and height in (64, 128), "a power of two"
    # Green of the normals against the archive's, whose rows are as many.
    stored = np.frombuffer(zipfile.ZipFile(archive).read("maps/specular_normal.png"), np.uint8)
    green = np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR_RGB)).astype(float)[..., 1] - 128
    made = pixels(kit.folder / f"textures/head_normal_{'opengl' if up else 'directx'}.png")[..., 1] - 127.5
    alike = np.corrcoef(cv2.resize(green, (128, 128), interpolation=cv2.INTER_AREA).ravel(), made.ravel())[0, 1]
    assert alike > 0.95 if up else alike < -0.95
    for number, level in enumerate(facts["levels"]):
        data = (kit.folder / level["file"]).read_bytes()
        issues = validator_report(data, tmp_path)["issues"]
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), (number, issues["messages"])
        names = [mesh["name"] for mesh in Glb.read(data).json["meshes"]]
        assert "skin" in names and "toy_hair" in names and "lashes" not in names
    if tool == "unreal":  # the option as Unreal and docs/unreal.md name it
        assert any("Flip Green Channel stays off" in one["use"] for one in facts["textures"])
    if tool == "unity":
        mask = pixels(kit.folder / "textures/head_mask.png")
        roughness = pixels_of(archive, "maps/roughness.png")
        assert (mask[..., 0] == 0).all() and abs(float(mask[..., 3].mean()) - (255 - float(roughness.mean()))) < 2


def pixels_of(archive: Path, name: str) -> npt.NDArray[np.uint8]:
    data = np.frombuffer(zipfile.ZipFile(archive).read(name), np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)


def test_blenders_kit_without_blender(archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blender, "blender", lambda: None)
    done = CliRunner().invoke(app, ["export", str(archive), "--for", "blender", "-o", str(tmp_path / "kit")])
    assert done.exit_code == 0 and "avatar_scene.py" in done.stderr
    facts = json.loads((tmp_path / "kit" / "kit.json").read_text())
    for material in facts["materials"]:
        for path in material["maps"].values():
            assert (tmp_path / "kit" / path).is_file()
    compile((tmp_path / "kit" / "avatar_scene.py").read_text(), "avatar_scene.py", "exec")
    assert (tmp_path / "kit" / "mesh" / "head.usda").is_file() and (tmp_path / "kit" / facts["environment"]).is_file()


def test_what_cannot_be_exported(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cinema"):
        export_kit(archive, "cinema", tmp_path / "kit")
    with pytest.raises(UsageError, match="no archive"):
        export_kit(tmp_path / "none.zip", "unity", tmp_path / "kit")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    with pytest.raises(UsageError, match="other files"):
        export_kit(archive, "blender", tmp_path / "full")
    (tmp_path / "odd.zip").write_bytes(b"PK")
    with pytest.raises(BadArchive):
        export_kit(tmp_path / "odd.zip", "unity", tmp_path / "kit")
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as evil:
        evil.writestr("../evil", b"")
    with pytest.raises(BadArchive, match="evil"):
        export_kit(tmp_path / "evil.zip", "unity", tmp_path / "kit")


@pytest.mark.parametrize("tool", ["blender", "maya"])
@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("camera",), {}),
        (("camera", "rotation"), [[float("nan")] * 3] * 3),
        (("fit", "light"), {"coefficients": [[1e300] * 3] * 9}),
        (("fit", "light"), {"coefficients": "bright"}),
        (("fit", "expression"), [1, 2]),
        (("head",), None),
        (("maps",), [{"units": ["jawOpen"]}]),
    ],
)
def test_a_manifest_of_other_things_is_refused_before_anything_is_written(
    archive: Path, tmp_path: Path, tool: str, where: tuple[str, ...], value: object
) -> None:
    with zipfile.ZipFile(archive) as whole, zipfile.ZipFile(tmp_path / "odd.zip", "w") as odd:
        for name in whole.namelist():
            data = whole.read(name)
            if name == "manifest.json":
                manifest = json.loads(data)
                manifest["camera"] = {"rotation": np.eye(3).tolist()}
                manifest["fit"]["light"] = {"coefficients": [[1.0] * 3] * 9}
                inner = manifest if len(where) == 1 else manifest[where[0]]
                inner[where[-1]] = value
                data = json.dumps(manifest).encode()
            odd.writestr(name, data)
    with pytest.raises(BadArchive, match="cannot be used"):
        export_kit(tmp_path / "odd.zip", tool, tmp_path / "kit")
    assert not (tmp_path / "kit").exists()


def test_of_hair_whole_ribbons_are_left_and_get_wider() -> None:
    hair, edge, cap = hair_parts(make_groom(NAMED["bob"], 3, 1500), mean_scalp(), Budget(9_000, 256))
    for part in (hair, edge, cap):
        for share, less in zip((1.0, 0.5, 0.1), reduced(part, (1.0, 0.5, 0.1)), strict=True):
            assert len(less.faces) <= len(part.faces)
            if part is hair:
                assert len(less.faces) == pytest.approx(share * len(hair.faces), rel=0.05)
            assert less.normals is not None
            assert np.isfinite(less.vertices).all()
    wide = np.linalg.norm(hair.vertices[1::2] - hair.vertices[::2], axis=1)
    half = reduced(hair, (0.5,))[0]
    assert np.linalg.norm(half.vertices[1::2] - half.vertices[::2], axis=1).mean() > 1.3 * wide.mean()
