"""The archive as a whole."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.archive.images import decode_normals8
from service.archive.pack import archive_members, write_archive
from service.errors import NumericFault
from service.texture.texture import PhotoTexture
from tests.service.archive.toys import toy_avatar, toy_texture


@pytest.fixture(scope="module")
def members() -> dict[str, bytes]:
    return archive_members(toy_avatar())


def decode(data: bytes) -> npt.NDArray[np.uint8]:
    image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), np.uint8)
    return image if image.ndim == 2 else image[..., ::-1]


def test_maps_hold_the_values_that_the_manifest_says(members: dict[str, bytes]) -> None:
    maps = toy_texture()
    coding = {entry["role"]: entry["coding"] for entry in json.loads(members["manifest.json"])["maps"]}
    np.testing.assert_array_equal(decode(members["maps/texture.png"]), maps.texture)
    np.testing.assert_array_equal(decode(members["maps/confidence.png"]), maps.confidence)
    codes = decode(members["maps/shape_normal.png"])
    values = (codes.astype(float) - coding["shape_normal"]["zero"]) / coding["shape_normal"]["scale"]
    np.testing.assert_allclose(values, maps.shape_normal_object, atol=0.5 / 127 + 1e-6)
    np.testing.assert_allclose(values, decode_normals8(codes), atol=1e-6)


def test_of_several_photos_the_archive_tells_how_many_show_a_texel(members: dict[str, bytes]) -> None:
    texture, blank = toy_texture(), np.zeros((64, 96, 3), np.uint8)
    shown = [np.where(np.arange(96) < end, 255, 0)[None].repeat(64, 0).astype(np.uint8) for end in (96, 40)]
    photos = tuple(PhotoTexture(blank, one, one, one, blank.astype(np.float32)) for one in shown)
    several = archive_members(toy_avatar(texture=replace(texture, photos=photos)))
    np.testing.assert_array_equal(decode(several["maps/seen_by.png"])[0], np.where(np.arange(96) < 40, 2, 1))
    coding = {entry["role"]: entry["coding"] for entry in json.loads(several["manifest.json"])["maps"]}
    assert coding["seen_by"]["zero"] == 0 and coding["seen_by"]["scale"] == 1
    assert "maps/seen_by.png" not in members


def test_nothing_is_written_where_a_result_is_not_finite(tmp_path: Path) -> None:
    avatar = toy_avatar()
    broken = avatar.fit.vertices.copy()
    broken[5, 1] = np.nan
    with pytest.raises(NumericFault):
        write_archive(replace(avatar, fit=replace(avatar.fit, vertices=broken)), tmp_path / "a.zip")
    assert list(tmp_path.iterdir()) == []
