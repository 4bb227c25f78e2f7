"""Normals against closed forms; smooth fields solve their equations, reach everywhere and refuse what has no answer."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from service.errors import NumericFault
from service.geometry.chart import Chart
from service.geometry.mesh import laplacian, normalise, smooth_fit, splat, vertex_normals
from tests.toyhead import sphere_head


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


HEAD = sphere_head(24, 48)
COUNT = len(HEAD.mean)
SKIN_TRIANGLES = HEAD.triangles[HEAD.triangle_part == 0]
SKIN = np.unique(SKIN_TRIANGLES)


def test_the_field_solves_its_equations_to_rounding() -> None:
    """Against a dense solve of the same quadratic form, put together edge by edge."""
    rng = np.random.default_rng(0)
    similarity = rng.uniform(size=COUNT)
    values, trust = rng.uniform(size=(COUNT, 2)), rng.uniform(size=COUNT) * (rng.uniform(size=COUNT) > 0.7)
    field = smooth_fit(laplacian(HEAD.triangles, COUNT, similarity), values, trust, 0.7, np.array([0.2, 0.9]), 0.05)
    dense = np.diag(trust + 0.05)
    edges = {tuple(sorted(pair)) for a, b, c in HEAD.triangles.tolist() for pair in ((a, b), (b, c), (c, a))}
    for one, other in edges:
        weight = 0.7 * (np.exp(-(((similarity[one] - similarity[other]) / 0.15) ** 2)) + 0.02)
        dense[[one, other], [one, other]] += weight
        dense[[one, other], [other, one]] -= weight
    expected = np.linalg.solve(dense, trust[:, None] * values + 0.05 * np.array([0.2, 0.9]))
    assert np.abs(field - expected).max() < 1e-12


def test_one_known_vertex_colours_the_whole_head() -> None:
    """With hardly any prior nothing else pulls at the far side, however many edges away it is."""
    trust = np.zeros(COUNT)
    trust[SKIN[HEAD.mean[SKIN, 2].argmax()]] = 1.0
    field = smooth_fit(laplacian(SKIN_TRIANGLES, COUNT), np.ones((COUNT, 1)), trust, 2.0, np.array([0.0]), 1e-9)
    assert field[SKIN].min() > 0.9999


def test_vertices_without_an_edge_go_by_their_own_value_and_the_prior() -> None:
    edges = laplacian(np.array([[1, 1, 1]]), 3)
    assert edges.nnz == 0
    field = smooth_fit(edges, np.ones((3, 1)), np.array([0.0, 1.0, 3.0]), 5.0, np.zeros(1), 1.0)
    assert np.allclose(field[:, 0], [0, 1 / 2, 3 / 4], atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_has_no_answer_is_refused(bad: float) -> None:
    edges, values, trust = laplacian(HEAD.triangles, COUNT), np.ones((COUNT, 1)), np.ones(COUNT)
    with pytest.raises(NumericFault, match="NaN or Inf"):
        smooth_fit(edges, values, np.where(np.arange(COUNT) == 7, bad, trust), 1.0, np.zeros(1), 0.1)
    with pytest.raises(NumericFault, match="NaN or Inf"):
        smooth_fit(edges, np.where(np.arange(COUNT)[:, None] == 7, bad, values), trust, 1.0, np.zeros(1), 0.1)
    with pytest.raises(NumericFault, match="NaN or Inf"):
        smooth_fit(edges, values, trust, 1.0, np.array([bad]), 0.1)
    with pytest.raises(ValueError, match="prior_trust is 0"):
        smooth_fit(edges, values, trust, 1.0, np.zeros(1), 0.0)


def test_splat_gives_back_a_linear_field() -> None:
    chart = Chart.build(HEAD, 192, 128)
    texels = chart.inside(HEAD.mean)
    mean, trust = splat(chart.corners, chart.weights, texels, np.full(len(texels), 0.5, np.float32), COUNT)
    assert np.allclose(trust[SKIN], 0.5)
    assert np.abs(mean[SKIN] - HEAD.mean[SKIN]).max() < 0.006


@pytest.mark.parametrize("vector", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [1e-30, 0, 0], [1e300, 1e300, 0]])
def test_vectors_without_direction_take_the_fallback(vector: list[float]) -> None:
    assert np.array_equal(normalise(np.array([vector]), (0.0, 1.0, 0.0)), [[0, 1, 0]])
