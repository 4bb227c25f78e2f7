"""Normals against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from service.geometry.mesh import normalise, vertex_normals


def test_sphere_normals_are_its_positions() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    normals = vertex_normals(sphere.vertices, sphere.faces)
    assert np.einsum("ni,ni->n", normals, sphere.vertices / 0.1).min() > 1 - 1e-4


def test_cube_corner_does_not_depend_on_the_diagonals() -> None:
    """Area or uniform weights would lean towards the face that is cut into two triangles at the corner."""
    box = trimesh.creation.box()
    normals = vertex_normals(box.vertices, box.faces)
    assert np.allclose(normals, np.sign(box.vertices) / np.sqrt(3), atol=1e-12)


def test_degenerate_triangles_add_nothing() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0], [5, 5, 5]], float)
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 0, 1], [0, 1, 4]])
    normals = vertex_normals(vertices, triangles)
    assert np.allclose(normals[:3], [0, 0, 1])
    assert np.array_equal(normals[3:], np.tile([0.0, 0.0, 1.0], (3, 1)))


@pytest.mark.parametrize("vector", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [1e-30, 0, 0], [1e300, 1e300, 0]])
def test_vectors_without_direction_take_the_fallback(vector: list[float]) -> None:
    assert np.array_equal(normalise(np.array([vector]), (0.0, 1.0, 0.0)), [[0, 1, 0]])
