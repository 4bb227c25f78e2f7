"""Heads with known colours: those of the light stage keep the colours of their chart, the scan its size and place."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.subjects import PUPILS_M, SCAN_LIDS, scan, staged
from tests.toyhead import EYE_RADIUS, EYE_X, sphere_head


def test_colours_of_a_staged_head_lie_where_the_chart_has_them() -> None:
    """Left and right of the chart are left and right of the head; the cut at the back mixes nothing."""
    head = sphere_head()
    albedo = np.zeros((64, 96, 3))
    albedo[:, :48] = [0.6, 0.1, 0.1]
    albedo[:, 48:] = [0.1, 0.1, 0.6]
    made = staged("toy", head, head.mean.astype(np.float64), albedo)
    x = made.vertices[:, 0]
    assert (made.colours[x < -0.002] == [0.6, 0.1, 0.1]).all()
    assert (made.colours[x > 0.002] == [0.1, 0.1, 0.6]).all()
    np.testing.assert_allclose(made.eyes, [[EYE_X, 0, 0], [-EYE_X, 0, 0]], atol=1e-6)
    assert made.eye_radius == pytest.approx(EYE_RADIUS, rel=0.02)
    assert len(made.vertices) > 8 * len(head.mean), "a colour a vertex is the detail that there is"


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
