from __future__ import annotations

import numpy as np
import pytest

from service.arrays import Float64, Int64
from service.geometry.mesh import face_normals
from service.geometry.remesh import Subdivision, split_in_four

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def test_faces_keep_their_side_and_the_surface_stays_closed() -> None:
    points, faces = CUBE, CUBE_FACES
    for _ in range(3):
        step = Subdivision.of(faces, len(points))
        points, faces = step.smooth(points), step.quads
    assert len(faces) == 6 * 4**3
    outward = face_normals(points, faces[:, :3])
    assert (np.einsum("ti,ti->t", outward, points[faces].mean(1)) > 0).all()
    sides = np.stack([faces, np.roll(faces, -1, 1)], 2).reshape(-1, 2)
    assert len(np.unique(sides, axis=0)) == len(sides), "an edge is run along twice in the same direction"
    assert {tuple(s) for s in sides} == {tuple(s[::-1]) for s in sides}


def test_a_flat_sheet_with_an_open_border_stays_flat_and_keeps_its_outline() -> None:
    """And a triangle among quads becomes three quads."""
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0], [0.5, 2, 0]], float)
    faces = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 6, -1]])
    step = Subdivision.of(faces, len(points))
    smooth = step.smooth(points)
    assert len(step.quads) == 4 + 4 + 3 and step.owner.tolist() == [0] * 4 + [1] * 4 + [2] * 3
    assert (smooth[:, 2] == 0).all()
    assert smooth[1].tolist() == [1, 0, 0], "the middle of a straight border stays on it"
    assert (face_normals(smooth, step.quads[:, :3])[:, 2] > 0).all()


def area(points: Float64, triangles: Int64) -> float:
    first, second, third = (points[corner] for corner in triangles.T)
    return 0.5 * float(np.abs(np.cross(second - first, third - first)[:, 2]).sum())


def test_a_triangle_is_split_in_four() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    both = np.array([[0, 1, 2], [1, 3, 2]])
    points, triangles = split_in_four(corners, both, np.array([True, False]))
    assert len(triangles) == 5 and area(points, triangles) == pytest.approx(1.0)
    assert (triangles[-1] == both[1]).all(), "order stays"
