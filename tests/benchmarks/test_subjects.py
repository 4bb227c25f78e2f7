"""Heads with known colours: those of the light stage keep the colours of their chart, the scan its size and place."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.subjects import PUPILS_M, SCAN_LIDS, scan

pytestmark = pytest.mark.train


def test_the_scan_comes_in_metres_with_its_colours_the_right_way_up(tmp_path: Path) -> None:
    """Two triangles, high ones and low ones on the chart as in the file: v counted from the bottom."""
    import trimesh

    folder = tmp_path / "lee_perry_smith"
    folder.mkdir()
    above = SCAN_LIDS.mean(0)
    vertices = above + np.array([[-1, 1, 0], [1, 1, 0], [0, 0.5, 0], [-1, -1, 0], [1, -1, 0], [0, -1.5, 0]])
    uv = np.array([[0.1, 0.9], [0.9, 0.9], [0.5, 0.8], [0.1, 0.1], [0.9, 0.1], [0.5, 0.2]]) * [1, -1] + [0, 1]
    mesh = trimesh.Trimesh(vertices, [[0, 2, 1], [3, 5, 4]], process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv)  # type: ignore[no-untyped-call]
    mesh.export(folder / "head.glb")
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32] = 255
    cv2.imwrite(str(folder / "color.jpg"), image)
    (found,) = scan(tmp_path, tmp_path)
    up = found.vertices[:, 1] > 0
    assert up.any() and (~up).any()
    assert found.colours[up].min() > 0.9 and found.colours[~up].max() < 0.1
    assert np.linalg.norm(found.eyes[0] - found.eyes[1]) == pytest.approx(PUPILS_M)
    nearest = np.linalg.norm(found.vertices[:, None] - found.eyes, axis=2).min()
    assert nearest > 1.05 * found.eye_radius, "eyeballs would show through the closed lids"
