"""One head, one look: in Mitsuba and in three.js, pictures of the three formats agree, as in ``test_in_blender.py``.

Mitsuba has no loaders of materials, so the formats are read by ``tests/tools/surfaces.py``; three.js draws what its own
loaders read. ``python -m tests.tools.mitsuba_look`` and ``python -m tests.tools.three_look`` do it with any archive.
"""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from service.archive.avatar import Avatar
from service.archive.pack import write_archive
from tests.service.archive.toys import whole_avatar
from tests.tools.surfaces import FORMATS, surfaces
from tests.tools.three_look import THREE, look

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow

LARGEST_MEAN = 2.0
"""Mean difference of pictures of the same head from two formats, in 1/255."""
SIZE = 160


def smooth(image: np.ndarray) -> np.ndarray:
    """Noise from texel to texel would measure how a renderer filters, not what a format says."""
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 6.0)
    return np.asarray(np.rint(blurred), image.dtype)


def smooth_avatar() -> Avatar:
    avatar = whole_avatar()
    made = avatar.reflectance
    assert made is not None and made.diffuse_albedo is not None and made.specular_albedo is not None
    assert made.specular_normal is not None
    return replace(
        avatar,
        reflectance=replace(
            made,
            diffuse_albedo=smooth(made.diffuse_albedo),
            specular_albedo=smooth(made.specular_albedo),
            specular_normal=smooth(made.specular_normal),
        ),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("renderers")
    write_archive(smooth_avatar(), path / "toy.zip")
    with zipfile.ZipFile(path / "toy.zip") as stored:
        stored.extractall(path / "in")
    return path / "in"


def difference(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one.astype(float) - other.astype(float)).mean())


def test_the_formats_say_the_same(folder: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed (make setup)")
    read = {kind: {one.name: one for one in surfaces(folder, kind)} for kind in FORMATS}
    assert set(read["glb"]) == set(read["obj"]) == set(read["usd"]) and "toy_hair" in read["glb"]
    for name, one in read["glb"].items():
        for kind in ("obj", "usd"):
            other = read[kind][name]
            # GLB and USD have corners of their own: the same places, not the same list.
            low, high = (getattr(np, which)(one.points, 0) for which in ("min", "max"))
            np.testing.assert_allclose(low, other.points.min(0), atol=2e-5, err_msg=f"{kind} {name}")
            np.testing.assert_allclose(high, other.points.max(0), atol=2e-5, err_msg=f"{kind} {name}")
            assert one.f0.mean() == pytest.approx(other.f0.mean(), abs=2e-4), (kind, name)
            assert one.roughness.mean() == pytest.approx(other.roughness.mean(), abs=0.005), (kind, name)
            assert one.opacity.mean() == pytest.approx(other.opacity.mean(), abs=0.005), (kind, name)
            np.testing.assert_allclose(one.colour.mean((0, 1)), other.colour.mean((0, 1)), atol=0.01, err_msg=name)


def test_mitsuba_shows_the_formats_alike(folder: Path) -> None:
    pytest.importorskip("mitsuba", reason="mitsuba is not installed (pip install -e '.[train]')")
    pytest.importorskip("pxr", reason="usd-core is not installed (make setup)")
    from tests.tools.mitsuba_look import bounds, draw, shown

    read = {kind: surfaces(folder, kind) for kind in FORMATS}
    box = bounds(read["glb"])
    pictures = {kind: shown(draw(one, box, SIZE, 16)) for kind, one in read.items()}
    assert pictures["glb"].std() > 10, "something is drawn"
    for one, other in (("glb", "obj"), ("glb", "usd"), ("obj", "usd")):
        assert difference(pictures[one], pictures[other]) <= LARGEST_MEAN, (one, other)
    # What the test would not see is seen: a material that mirrors twice as much.
    for each in read["usd"]:
        each.f0 = each.f0 * 2.0
        each.colour = each.colour * 0.8
    assert difference(shown(draw(read["usd"], box, SIZE, 16)), pictures["glb"]) > LARGEST_MEAN


@pytest.mark.skipif(not THREE.is_dir(), reason="three.js is not in tests/tools/node_modules (make setup, with npm)")
def test_three_js_shows_the_formats_alike(folder: Path, tmp_path: Path, browser: Browser) -> None:
    materials = look(browser, folder, tmp_path, SIZE)
    assert set(materials.values()) == {"MeshPhysicalMaterial"}
    pictures = {path.stem: np.asarray(cv2.imread(str(path))) for path in tmp_path.glob("*.png")}
    assert pictures["glb"].std() > 10, "something is drawn"
    assert difference(pictures["glb"], pictures["obj"]) <= LARGEST_MEAN
    assert difference(pictures["neutral_glb"], pictures["neutral_usd"]) <= LARGEST_MEAN
    assert difference(pictures["glb"], pictures["neutral_glb"]) > 0.05, "the photo's expression is shown"
