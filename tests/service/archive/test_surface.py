"""Normals of many poses, and parts with split vertices."""

from __future__ import annotations

import numpy as np

from service.archive.surface import FALLBACK_NORMAL, split_parts, vertex_normals
from tests.service.archive.toys import toy_head
from tests.toyhead import CENTRE


def test_normals_of_a_ball_point_away_from_its_centre() -> None:
    head = toy_head()
    skin = np.unique(head.triangles[head.triangle_part == 0])
    normals = vertex_normals(head.mean, head.triangles)[skin]
    outward = head.mean[skin] - CENTRE
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert (normals * outward).sum(1).min() > np.cos(np.radians(4.0)), "a turned winding or a bad weight"
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)


def test_many_poses_equal_one_at_a_time() -> None:
    head = toy_head()
    poses = head.mean + head.expression
    together = vertex_normals(poses, head.triangles)
    for pose, normals in zip(poses, together, strict=True):
        np.testing.assert_allclose(vertex_normals(pose, head.triangles), normals, atol=1e-6)


def test_triangles_without_area_give_unit_normals() -> None:
    """glTF refuses normals that are not of unit length; zero over zero would be NaN."""
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]], np.float32)
    normals = vertex_normals(points, np.array([[0, 1, 2], [0, 0, 0]]))
    np.testing.assert_array_equal(normals, np.tile(np.array(FALLBACK_NORMAL, np.float32), (4, 1)))


def test_a_micrometre_triangle_still_has_a_normal() -> None:
    points = np.array([[0, 0, 0], [0, 1e-6, 0], [0, 0, 1e-6]], np.float32)
    np.testing.assert_allclose(vertex_normals(points, np.array([[0, 1, 2]])), [[1, 0, 0]] * 3, atol=1e-6)


def test_parts_rebuild_the_head_and_split_only_at_cuts() -> None:
    head = toy_head()
    parts = split_parts(head)
    assert [part.name for part in parts] == list(head.part_names)
    for index, part in enumerate(parts):
        chosen = head.triangle_part == index
        np.testing.assert_array_equal(part.vertex[part.triangles], head.triangles[chosen])
        np.testing.assert_array_equal(part.uv[part.triangles], head.triangle_uv[chosen])
        assert len(np.unique(np.stack([part.vertex, part.uv]), axis=1).T) == len(part.vertex), "a pair occurs twice"
    skin = parts[0]
    assert len(skin.vertex) > len(np.unique(skin.vertex)), "the toy's chart is cut, so some vertices are split"
