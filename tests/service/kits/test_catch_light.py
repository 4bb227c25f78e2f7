"""A key light of half a metre shows in the eye as a photographer expects it, in each renderer that reads the GLB.

The light's strength is the one that shows skin at about 200 of 255. Old mistakes would fail here: a cornea whose alpha
scales its reflection away, one of which a screen clips the reflection before it is scaled, and one that is opaque to
shadow rays, behind which the iris is black.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.anatomy.eyes import eye_parts
from service.archive.glb import glb_bytes
from service.head.files import load_head
from service.kits.export import blender
from service.materials.part import head_parts
from tests.tools.three_look import THREE, look_at_an_eye

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow

WATTS = 14.0
TOOL = Path(__file__).resolve().parents[2] / "tools" / "blender_eye.py"


@dataclass(frozen=True)
class Rested:
    """What eyes need of a fit."""

    vertices: npt.NDArray[np.float32]
    neutral: npt.NDArray[np.float32]
    gaze: None = None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The mean head, wide-eyed, with its eyes, as ``mesh/head.glb``."""
    head = load_head()
    wide = np.array([0.7 * name.startswith("eyeWide") for name in head.expression_names])
    points = head.shape(np.zeros(len(head.identity)), wide)
    eyes = eye_parts(head, Rested(points, points), np.array([0.06, 0.10, 0.16]))  # type: ignore[arg-type]
    replaced = {name for part in eyes for name in part.replaces}
    parts = [part for part in head_parts(head, points, points) if part.name not in replaced]
    path = tmp_path_factory.mktemp("eye")
    (path / "mesh").mkdir()
    data = glb_bytes([*parts, *eyes], {}, units=(), expression={}, head="mean", licence="CC0")
    (path / "mesh" / "head.glb").write_bytes(data)
    (path / "manifest.json").write_text('{"materials": [], "parts": []}')
    return path


def check(picture: Path) -> None:
    """The iris is seen, neither black nor white, and a catch-light in it."""
    read = cv2.imread(str(picture))
    assert read is not None
    size = len(read)
    y, x = np.mgrid[0:size, 0:size] + 0.5 - size / 2
    iris = np.hypot(x, y) < 0.0035 / 0.016 * size  # what lids never cover
    bright = read.max(2)[iris]
    assert np.percentile(bright, 99.9) >= 240
    ring = iris & (np.hypot(x, y) > 0.0025 / 0.016 * size) & (y > 0)
    assert np.percentile(bright, 25) < 170, "no white sheet"
    blue, _, red = np.median(read[ring], 0)
    assert 30 < blue < 170 and blue > red, "a blue iris"


@pytest.mark.skipif(blender() is None, reason="no Blender: set AVATARME_BLENDER to it or to a Python with bpy")
def test_a_key_light_shows_in_the_eye_in_cycles_and_in_eevee(folder: Path, tmp_path: Path) -> None:
    command = blender()
    assert command is not None
    dashes = ["--"] if command[1:] else []
    arguments = [*command, str(TOOL), *dashes, str(folder / "mesh" / "head.glb"), str(tmp_path), str(WATTS)]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    for name in ("CYCLES", "EEVEE"):
        check(tmp_path / f"{name}.png")


@pytest.mark.skipif(not THREE.is_dir(), reason="three.js is not in tests/tools/node_modules (make setup, with npm)")
def test_a_key_light_shows_in_the_eye_in_three_js(folder: Path, tmp_path: Path, browser: Browser) -> None:
    look_at_an_eye(browser, folder, tmp_path / "three.png", WATTS)
    check(tmp_path / "three.png")
