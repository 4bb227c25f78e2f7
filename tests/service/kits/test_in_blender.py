"""Blender's own importers read the three formats alike, and the kit's scene is driven as a whole.

Blender is what ``service.kits.export.blender`` finds: AVATARME_BLENDER, ``blender``, or the module bpy, which cannot
share an environment with numpy 2: ``python -m venv blender; blender/bin/pip install "bpy<5"``.
"""

from __future__ import annotations

import json
import logging
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from service.archive.pack import write_archive
from service.head.files import triangle_fields
from service.kits.export import blender, export_kit
from service.reflectance.reflectance_maps import Wrinkle
from tests.end_to_end.command import avatarme as main_of
from tests.service.archive.toys import whole_avatar

SAMPLE = Path(__file__).resolve().parents[3] / "service" / "data" / "sample" / "astronaut.png"

TOOLS = Path(__file__).resolve().parents[2] / "tools"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(blender() is None, reason="no Blender: set AVATARME_BLENDER to it or to a Python with bpy"),
]

LARGEST_MEAN = 2.0
"""Mean difference of pictures of the same head from two formats, in 1/255."""


PIXELS, MM_A_PIXEL = 1600, 0.25
"""Side of the pictures of hair; 0.4 m at the head's distance."""
DARK, AROUND_PX = 0.25, 61
"""Luminance over that of the hair around, a median, below which a pixel is dark, and the side of what is around."""
SLIT_MM2, HOLE_MM2 = 220.0, 1.0
"""Largest dark part of hair that is allowed, slits between cards and the shade under a fringe, and largest hole in the
hair of the crown: a loan, as no slit is wanted."""


def run(tool: str, *arguments: object) -> None:
    command = blender()
    assert command is not None
    dashes = ["--"] if command[1:] else []
    done = subprocess.run(
        [*command, str(TOOLS / tool), *dashes, *map(str, arguments)], capture_output=True, text=True, timeout=3600
    )
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("blender") / "toy.zip"
    avatar = whole_avatar()
    made = avatar.reflectance
    assert made is not None and made.specular_normal is not None
    folded = Wrinkle("mouth", {"jawOpen": 0.5}, made.specular_normal)
    # With a hole in the skin, which is open at the neck of a real head.
    head = avatar.head
    kept = np.arange(len(head.polygons)) != len(head.polygons[head.polygon_part == 0]) // 2
    rows = {name: getattr(head, name)[kept] for name in ("polygons", "polygon_uv", "polygon_part")}
    fields: dict[str, Any] = rows | triangle_fields(*rows.values())
    open_head = replace(head, **fields)
    write_archive(replace(avatar, head=open_head, reflectance=replace(made, wrinkles=(folded,))), path)
    return path


@pytest.fixture(scope="module")
def look(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("look")
    with zipfile.ZipFile(archive) as stored:
        stored.extractall(folder / "in")
    run("blender_look.py", folder / "in", folder, 192, 8)
    return folder


def test_one_head_one_look(look: Path) -> None:
    pictures = {kind: np.asarray(cv2.imread(str(look / f"{kind}.png")), float) for kind in ("glb", "obj", "usd")}
    assert pictures["glb"].std() > 20, "something is drawn"
    for one, other in (("glb", "obj"), ("glb", "usd"), ("obj", "usd")):
        assert np.abs(pictures[one] - pictures[other]).mean() <= LARGEST_MEAN, (one, other)


def test_materials_are_wired_in_every_format(look: Path) -> None:
    facts = json.loads((look / "facts.json").read_text())
    for kind in ("glb", "obj", "usd"):
        told: dict[str, Any] = facts[kind]
        assert not any(one["missing"] for one in told.values()), kind
        inputs = {wire.split(" -> ")[1] for wire in told["skin"]["wires"]}
        assert {"Base Color", "Roughness", "Normal"} <= inputs, kind
        assert inputs & {"Specular IOR Level", "Specular Tint"}, kind
        assert any(wire.endswith("Alpha") for wire in told["toy_hair"]["wires"]), kind
    units = set(whole_avatar().head.expression_names)
    assert set(facts["glb"]["skin"]["keys"]) == units
    assert set(facts["usd"]["skin"]["keys"]) == units - {"tongueOut"}, "tongueOut moves nothing of the toy"


def test_the_kits_scene_is_driven_as_a_whole(archive: Path, tmp_path: Path) -> None:
    kit = export_kit(archive, "blender", tmp_path / "kit")
    assert kit.scene is not None and kit.scene.is_file()
    run("blender_kit.py", kit.scene, tmp_path)
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["bones"] == ["eye_left", "eye_right", "head", "jaw", "neck"] and facts["missing"] == []
    assert "skin" in facts["displaced"] and "skin" in facts["subdivided"] and "toy_hair" not in facts["subdivided"]
    avatar = whole_avatar()
    assert facts["units"] == len(avatar.head.expression_names) + 1
    jaw = avatar.head.expression[avatar.head.expression_names.index("jawOpen")]
    moved = facts["moved_mm"]["jawOpen"]
    for index, name in enumerate(avatar.head.part_names):
        if name in moved:
            own = np.unique(avatar.head.triangles[avatar.head.triangle_part == index])
            assert moved[name] == pytest.approx(1e3 * np.abs(jaw[own]).max(), abs=0.02), name
    assert facts["border_mm"] < 0.001, "the bust goes on where the smoothed skin ends"
    assert [facts["folds"][pose]["wrinkle_mouth"] for pose in ("neutral", "jawOpen", "photo")] == [0.0, 1.0, 1.0]
    assert moved["toy_hair"] == pytest.approx(4.0, abs=0.02), "one property moves all parts"
    assert not any(facts["moved_mm"]["neutral"].values())
    # The photo's expression, as the property "photo" gives it; Blender is Z up.
    shown = np.load(tmp_path / "photo.npz")["skin"]
    own = np.unique(avatar.head.triangles[avatar.head.triangle_part == 0])
    np.testing.assert_allclose(shown[:, [0, 2, 1]] * [1, 1, -1], avatar.fit.vertices[own], atol=2e-5)


def largest_mm2(where: np.ndarray) -> float:
    """Area of the largest connected part of a mask (H, W)."""
    count, _, facts, _ = cv2.connectedComponentsWithStats(where.astype(np.uint8), connectivity=8)
    return float(facts[1:, cv2.CC_STAT_AREA].max() if count > 1 else 0) * MM_A_PIXEL**2


def slit_mm2(picture: np.ndarray, hair: np.ndarray) -> float:
    """The largest dark part within hair: picture (H, W, 3) uint8, hair (H, W) in [0, 1], the share of it."""
    inner = cv2.erode((hair > 0.5).astype(np.uint8), np.ones((9, 9))) > 0
    linear = (picture[..., :3].mean(2) / 255) ** 2.2
    around = cv2.medianBlur(np.rint(255 * np.sqrt(linear)).astype(np.uint8), AROUND_PX)
    return largest_mm2(inner & (linear < DARK * np.square(around / 255.0)))


def hole_mm2(hair: np.ndarray) -> float:
    """The largest part without hair that hair surrounds, within 80 mm of its middle: seen from above, the crown."""
    solid = (hair > 0.5).astype(np.uint8)
    outside = np.pad(1 - solid, 1, constant_values=1)
    cv2.floodFill(outside, None, (0, 0), 0)
    rows, columns = np.indices(hair.shape)
    y, x = (float(np.average(values, weights=solid)) for values in (rows, columns))
    near = np.hypot(rows - y, columns - x) < 80 / MM_A_PIXEL
    return largest_mm2((outside[1:-1, 1:-1] > 0) & near)


def test_hair_has_no_slit_and_no_hole(tmp_path: Path) -> None:
    """A real head at ``standard``, under key and rim light from five sides.

    ``pytest --log-cli-level=info`` says what was measured.
    """
    avatar = tmp_path / "avatar.zip"
    assert main_of("make", SAMPLE, "-o", avatar, "--quality", "standard").status == 0
    with zipfile.ZipFile(avatar) as stored:
        stored.extract("mesh/head.glb", tmp_path)
    run("blender_hair.py", tmp_path / "mesh" / "head.glb", tmp_path, PIXELS, 8)
    for side in ("front", "three_quarter", "left", "back", "top"):
        picture, hair = (cv2.imread(str(tmp_path / f"{side}{end}.png"), cv2.IMREAD_UNCHANGED) for end in ("", "_hair"))
        assert picture is not None and hair is not None and hair.shape == (PIXELS, PIXELS, 4)
        share = hair[..., 3] / 255.0
        slit, hole = slit_mm2(picture, share), hole_mm2(share)
        logging.info("%s: hair %.3f of the picture, slit %.1f mm2, hole %.1f mm2", side, share.mean(), slit, hole)
        assert slit < SLIT_MM2 and (side not in ("back", "top") or hole < HOLE_MM2), side
