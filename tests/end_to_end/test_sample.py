"""The sample photo through the whole program, judged from outside: by the files that a user gets."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
from PIL import Image

from service.archive.avatar import Avatar
from service.archive.pack import archive_members
from service.face.fit.landmark_fit import at_barycentric
from service.head.files import save_head
from service.pipeline import make_avatar
from tests.end_to_end.command import ROOT, avatarme
from tests.end_to_end.conftest import QUICK, TEXTURE_ONLY, Pixels, Sample, png
from tests.service.archive.test_meshes import validator_report


def test_the_manifest_obeys_its_schema_and_describes_the_files(sample: Sample) -> None:
    jsonschema.validate(sample.manifest, json.loads((ROOT / "docs" / "manifest.schema.json").read_text("utf-8")))
    listed = {entry["path"]: (entry["size"], entry["sha256"]) for entry in sample.manifest["files"]}
    found = {name: (len(data), hashlib.sha256(data).hexdigest()) for name, data in sample.members.items()}
    assert listed == {name: facts for name, facts in found.items() if name != "manifest.json"}
    for entry in sample.manifest["maps"]:
        with Image.open(io.BytesIO(sample.members[entry["path"]])) as image:
            assert image.size == (entry["width"], entry["height"]) == (576, 384)


def test_the_khronos_validator_accepts_the_head(sample: Sample, tmp_path: Path) -> None:
    report = validator_report(sample.members["mesh/head.glb"], tmp_path)
    issues = report["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    names = json.loads(sample.members["mesh/head.glb"][20:].split(b"BIN\0")[0][:-4].rstrip())["meshes"][0]["extras"]
    assert len(names["targetNames"]) == 52


def test_the_camera_puts_the_head_where_the_face_is(sample: Sample, plain: Avatar) -> None:
    """The manifest's formula on the vertices of the OBJ file meets the detector's landmarks.

    A transposed rotation, a flipped axis, a principal point half a pixel off its convention by the size of the image,
    or an OBJ in another unit puts the head somewhere else.
    """
    lines = sample.members["mesh/head.obj"].decode().splitlines()
    vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
    head, camera = plain.head, sample.manifest["camera"]
    assert vertices.shape == head.mean.shape
    points = at_barycentric(vertices, head.triangles[head.landmark_triangle], head.landmark_barycentric)
    x, y, z = np.array(camera["rotation"]) @ points.T + np.array(camera["translation"])[:, None]
    assert (z > 0.2).all() and camera["rotation"][2][2] < 0, "the face looks at the camera, in front of it"
    pixels = camera["focal_px"] * np.stack([x, y], 1) / z[:, None] + camera["principal_point"]
    gap = np.linalg.norm(pixels - plain.face.landmarks[:, :2], axis=1)
    steady = ~np.isin(np.arange(len(gap)), head.contour_landmarks)
    eyes = np.linalg.norm(np.subtract(*plain.face.landmarks[[[33, 133], [362, 263]], :2].mean(1)))
    assert np.sqrt(np.mean(gap[steady] ** 2)) < 0.05 * eyes


def test_a_turn_in_the_exif_data_changes_nothing_and_goes_no_further(
    sample: Sample, portrait: Pixels, tmp_path: Path
) -> None:
    """The photo on its side with the tag that says so is the same photo: the same mesh, to the byte."""
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees clockwise to see it upright
    exif[0x010F] = "a maker that nobody has to know"
    (tmp_path / "side.png").write_bytes(png(np.ascontiguousarray(np.rot90(portrait)), exif=exif))
    run = avatarme("make", tmp_path / "side.png", "-o", "-", *TEXTURE_ONLY)
    assert run.status == 0, run.stderr
    with zipfile.ZipFile(io.BytesIO(run.stdout)) as archive:
        for name in ("mesh/head.obj", "mesh/head.glb", "maps/texture.png", "maps/confidence.png"):
            assert archive.read(name) == sample.members[name], name
    assert b"nobody has to know" not in run.stdout, "the archive is not compressed: nothing hides in it"


def test_another_head_model_takes_the_place_of_ours(portrait: Pixels, plain: Avatar, tmp_path: Path) -> None:
    """A user's own file, here a bare skin without blendshapes: the archive is of that head and says whose it is."""
    skin = plain.head.polygon_part == 0
    flat = plain.head.triangle_part == 0
    bare = replace(
        plain.head,
        name="another",
        licence="LicenseRef-mine",
        identity=plain.head.identity[:20],
        expression=plain.head.expression[:0],
        expression_names=(),
        polygons=plain.head.polygons[skin],
        polygon_uv=plain.head.polygon_uv[skin],
        polygon_part=plain.head.polygon_part[skin],
        part_names=("skin",),
        triangles=plain.head.triangles[flat],
        triangle_uv=plain.head.triangle_uv[flat],
        triangle_part=plain.head.triangle_part[flat],
        landmark_triangle=(np.cumsum(flat) - 1)[plain.head.landmark_triangle].astype(np.int32),
        contour_triangle=(np.cumsum(flat) - 1)[plain.head.contour_triangle].astype(np.int32),
    )
    assert flat[plain.head.landmark_triangle].all(), "landmarks lie on the skin"
    save_head(bare, tmp_path / "another.npz")
    members = archive_members(make_avatar(png(portrait), QUICK, head_file=tmp_path / "another.npz"))
    manifest = json.loads(members["manifest.json"])
    assert (manifest["head"]["name"], manifest["head"]["licence"]) == ("another", "LicenseRef-mine")
    assert manifest["head"]["parts"] == ["skin"] and manifest["head"]["blendshapes"] == []
    digest = hashlib.sha256((tmp_path / "another.npz").read_bytes()).hexdigest()
    assert [model["sha256"] for model in manifest["models"] if model["name"] == "another"] == [digest]
    assert b"LicenseRef-mine" in members["LICENSES.md"]
    assert members["mesh/head.obj"].count(b"\nf ") == skin.sum()
