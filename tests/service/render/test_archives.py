"""Archives that come from anywhere: bounded, checked, and refused with what is wrong."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from service.archive import reading
from service.archive.container import ArchiveFile
from service.archive.images import encode_png
from service.archive.obj import read_obj
from service.archive.pack import archive_members
from service.archive.reading import described_parts, open_avatar, unpack_map
from service.errors import BadArchive, BadMesh
from service.head.files import split_polygons
from service.materials.material import Material
from service.materials.part import part_normals
from tests.service.archive.toys import toy_avatar, whole_avatar

Files = dict[str, bytes]


@lru_cache(maxsize=1)
def members() -> tuple[tuple[str, bytes], ...]:
    return tuple(archive_members(toy_avatar()).items())


def zipped(files: Files, *, deflated: bool = False) -> io.BytesIO:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    stream.seek(0)
    return stream


def changed(**parts: bytes | None) -> Files:
    files = dict(members())
    for name, data in parts.items():
        path = name.replace("__", "/").replace("_DOT_", ".")
        if data is None:
            files.pop(path)
        else:
            files[path] = data
    return files


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (lambda: changed(mesh__head_DOT_obj=None), "mesh/head.obj"),
        (lambda: changed(manifest_DOT_json=None), "manifest.json"),
        (lambda: changed(manifest_DOT_json=b"{"), "not JSON"),
        (lambda: changed(manifest_DOT_json=b"[" * 100_000), "JSON"),
        (lambda: changed(manifest_DOT_json=b'{"schema_version": "2.0"}'), "2.0"),
        (lambda: changed(manifest_DOT_json=b'{"schema_version": "1.0", "maps": 3}'), "list of maps"),
        (lambda: {**dict(members()), "../evil": b"x"}, "evil"),
    ],
)
def test_what_is_no_archive_of_ours_is_refused(files: Callable[[], Files], words: str) -> None:
    with pytest.raises(BadArchive, match=words):
        open_avatar(zipped(files()), ("texture",))


def test_parts_are_lit_as_they_were_made() -> None:
    """Beside a part with normals of its own, all others were lit as if they faced upwards: eyes and teeth were dark."""
    avatar = whole_avatar()
    [sheet] = avatar.parts
    turned = replace(sheet, normals=np.tile(np.array([0.6, 0.0, 0.8], np.float32), (len(sheet.vertices), 1)))
    plain = replace(sheet, name="plain", material=Material("plain", colour_map=sheet.material.colour_map))
    made = replace(avatar, parts=(turned, plain))
    stored_parts = open_avatar(zipped(dict(archive_members(made))), ("diffuse_albedo",)).parts
    read = {part.name: part for part in stored_parts}
    for part in made.parts:
        own, stored = (part_normals(p, p.vertices, split_polygons(p.polygons)) for p in (part, read[part.name]))
        np.testing.assert_allclose(stored.mean(0), own.mean(0), atol=0.02, err_msg=part.name)


@pytest.mark.parametrize("data", [b"", b"PK\x05\x06" + bytes(18), b"not a zip"])
def test_what_is_no_zip_is_refused(data: bytes) -> None:
    with pytest.raises(BadArchive):
        open_avatar(io.BytesIO(data), ("texture",))


def test_a_bomb_is_not_unpacked() -> None:
    """A member of a few kilobytes that unfolds to megabytes; the bound holds whatever the header says."""
    bomb = zipped(changed(maps__texture_DOT_png=bytes(8 << 20)), deflated=True)
    assert len(bomb.getvalue()) < 6 << 20
    with pytest.raises(BadArchive, match="unpacks to more than 1048576 bytes"):
        ArchiveFile.open(bomb).read("maps/texture.png", 1 << 20)


def test_a_damaged_member_is_refused() -> None:
    data = bytearray(zipped(dict(members())).getvalue())
    at = bytes(data).index(b"mtllib head.mtl")
    data[at] ^= 0xFF
    with pytest.raises(BadArchive, match="CRC"):
        open_avatar(io.BytesIO(bytes(data)), ())


def test_an_archive_of_another_version_is_read() -> None:
    """Keys that are new or have gone are passed over; what was clear glass before the eyes is not drawn."""
    manifest = json.loads(dict(members())["manifest.json"])
    for one in manifest["materials"]:
        one |= {"transmission": float(one["name"] == manifest["materials"][-1]["name"]), "future": [1]}
    manifest["parts"][0]["future"] = True
    parts, materials = described_parts(manifest)
    assert len(materials) == len(manifest["materials"])
    assert len(parts) == sum(one["material"] != manifest["materials"][-1]["name"] for one in manifest["parts"])
    with pytest.raises(BadArchive, match="parts or materials"):
        described_parts({"materials": 3})


@pytest.mark.parametrize("entry", [{"bits": 12}, {"frame": "moon"}, {"coding": {"zero": 0, "scale": 0}}, {"coding": 3}])
def test_entries_of_maps_that_make_no_sense_are_refused(entry: dict[str, object]) -> None:
    manifest = json.loads(dict(members())["manifest.json"])
    for item in manifest["maps"]:
        item.update(entry)
    with pytest.raises(BadArchive, match="texture"):
        open_avatar(zipped(changed(manifest_DOT_json=json.dumps(manifest).encode())), ("texture",))


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (b"nonsense", "texture"),
        (encode_png(np.zeros((64, 64), np.uint8), srgb=False), "3:2"),
        (encode_png(np.zeros((64, 96), np.uint8), srgb=False)[:-20], "texture"),
    ],
)
def test_maps_that_cannot_be_read_are_refused_by_name(image: bytes, words: str) -> None:
    with pytest.raises(BadArchive, match=words):
        unpack_map(image, "texture")


def test_a_huge_map_is_refused_before_it_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "LIMITS", replace(reading.LIMITS, max_pixels=1000))
    with pytest.raises(BadArchive, match="1000"):
        unpack_map(encode_png(np.zeros((64, 96), np.uint8), srgb=False), "texture")


def test_codes_of_data_are_kept_whatever_gamma_the_file_states() -> None:
    """A PNG with a gAMA chunk: its codes are numbers, not colours to be converted."""
    import struct
    import zlib

    codes = np.arange(96, dtype=np.uint8).reshape(8, 12).repeat(3, 0).repeat(3, 1)
    plain = encode_png(codes, srgb=False)
    body = b"gAMA" + struct.pack(">I", 100_000)
    chunk = struct.pack(">I", 4) + body + struct.pack(">I", zlib.crc32(body))
    found = unpack_map(plain[:33] + chunk + plain[33:], "confidence")
    np.testing.assert_array_equal(found[..., 0], codes)


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no faces"),
        ("v 0 0\nf 1 1 1", "line 1"),
        ("v 0 0 nan\n", "nan"),
        ("v 0 0 inf\n", "inf"),
        ("v a b c\n", "not numbers"),
        (TRIANGLE + "f 1/1 2/2 4/3\n", "line 7.*4"),
        (TRIANGLE + "f 1/1 2/2 0/3\n", "v 0"),
        (TRIANGLE + "f 1/1 2/2\n", "2 corners"),
        (TRIANGLE + "f 1/1 2/2 3/3 1/1 2/2\n", "5 corners"),
        (TRIANGLE + "f 1/1 2/2 x/3\n", "not an index"),
    ],
)
def test_meshes_that_make_no_sense_are_refused_by_line(text: str, words: str) -> None:
    with pytest.raises(BadMesh, match=words):
        read_obj(text.encode())


def test_a_mesh_without_a_chart_cannot_carry_maps() -> None:
    with pytest.raises(BadMesh, match="texture coordinates"):
        read_obj((TRIANGLE + "f 1 2 3\n").encode()).as_head("x", "y")
    with pytest.raises(BadMesh, match=r"\[0, 1\]"):
        read_obj((TRIANGLE.replace("vt 1 0", "vt 2 0") + "f 1/1 2/2 3/3\n").encode()).as_head("x", "y")
