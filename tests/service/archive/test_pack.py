"""The archive as a whole."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.archive.avatar import licences_text
from service.archive.container import MEMBERS
from service.archive.images import decode_normals8
from service.archive.maps import GLB_TEXTURE_PX, chart_pictures
from service.archive.pack import archive_members, write_archive
from service.errors import NumericFault
from service.reflectance.reflectance_maps import Reflectance
from tests.service.archive.toys import toy_avatar, toy_texture


@pytest.fixture(scope="module")
def members() -> dict[str, bytes]:
    return archive_members(toy_avatar())


def decode(data: bytes) -> npt.NDArray[np.uint8]:
    image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), np.uint8)
    return image if image.ndim == 2 else image[..., ::-1]


def test_the_same_avatar_gives_the_same_bytes_to_file_and_stream(tmp_path: Path) -> None:
    """Two avatars made apart, and other timings and memory: those differ between any two runs."""
    stream = io.BytesIO()
    write_archive(toy_avatar(), stream)
    write_archive(toy_avatar(timings_s={"decode": 9.9}, peak_rss_mb=1.0), tmp_path / "a.zip")
    assert (tmp_path / "a.zip").read_bytes() == stream.getvalue()


def test_strict_extraction_into_a_folder(tmp_path: Path) -> None:
    write_archive(toy_avatar(), tmp_path / "a.zip")
    root = (tmp_path / "out").resolve()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        for entry in archive.infolist():
            target = (root / entry.filename).resolve()
            assert target.is_relative_to(root) and target != root
            assert not entry.is_dir()
        archive.extractall(root)
        assert archive.namelist() == [name for name in MEMBERS if name in archive.namelist()]
    assert len([path for path in root.rglob("*") if path.is_file()]) == len(archive.namelist())


def test_maps_hold_the_values_that_the_manifest_says(members: dict[str, bytes]) -> None:
    maps = toy_texture()
    coding = {entry["role"]: entry["coding"] for entry in json.loads(members["manifest.json"])["maps"]}
    np.testing.assert_array_equal(decode(members["maps/texture.png"]), maps.texture)
    np.testing.assert_array_equal(decode(members["maps/confidence.png"]), maps.confidence)
    codes = decode(members["maps/shape_normal.png"])
    values = (codes.astype(float) - coding["shape_normal"]["zero"]) / coding["shape_normal"]["scale"]
    np.testing.assert_allclose(values, maps.shape_normal_object, atol=0.5 / 127 + 1e-6)
    np.testing.assert_allclose(values, decode_normals8(codes), atol=1e-6)


def test_the_licences_name_the_models_and_the_terms(members: dict[str, bytes]) -> None:
    text = members["LICENSES.md"].decode()
    assert "CC0-1.0" in text and "cd" * 32 in text and "without asking" in text
    head = replace(toy_avatar().head, licence="LicenseRef-other")
    assert "without asking" not in licences_text(toy_avatar(head=head))


def test_nothing_is_written_where_a_result_is_not_finite(tmp_path: Path) -> None:
    avatar = toy_avatar()
    broken = avatar.fit.vertices.copy()
    broken[5, 1] = np.nan
    with pytest.raises(NumericFault):
        write_archive(replace(avatar, fit=replace(avatar.fit, vertices=broken)), tmp_path / "a.zip")
    assert list(tmp_path.iterdir()) == []


def test_a_large_texture_is_made_smaller_for_the_glb() -> None:
    flat = np.full((2048, 3072, 3), (200, 40, 90), np.uint8)
    for albedo in (None, flat.astype(np.uint16) * 257):
        made = None if albedo is None else Reflectance(size=(3072, 2048), diffuse_albedo=albedo)
        avatar = toy_avatar(texture=replace(toy_texture(), texture=flat), reflectance=made)
        picture = chart_pictures(avatar)["diffuse_albedo"]
        image = decode(picture.data)
        assert picture.mime == "image/jpeg" and image.shape == (1365, GLB_TEXTURE_PX, 3)
        assert np.abs(image.astype(int) - (200, 40, 90)).max() <= 3
    assert decode(chart_pictures(toy_avatar())["diffuse_albedo"].data).shape == (64, 96, 3)
