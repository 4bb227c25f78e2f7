"""The chart of the toy sphere against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.chart import Chart, mirrored_map, nearest_inside, solve_affine
from tests.toyhead import CENTRE, RADIUS, SKIN_U, SKIN_V, sphere_head

WIDTH, HEIGHT = 192, 128


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart.build(sphere_head(40, 60), WIDTH, HEIGHT)


def _skin_interior(chart: Chart) -> np.ndarray:
    """Skin texels away from the poles, where the chart is singular."""
    inside = chart.part == 0
    row = np.nonzero(inside)[0]
    inside[: row.min() + 8] = False
    inside[row.max() - 7 :] = False
    return np.asarray(inside)


def _longitude_latitude(chart: Chart) -> tuple[np.ndarray, np.ndarray]:
    u = (np.arange(WIDTH) + 0.5) / WIDTH
    v = 1 - (np.arange(HEIGHT) + 0.5) / HEIGHT
    longitude = ((u - SKIN_U[0]) / (SKIN_U[1] - SKIN_U[0]) * 2 - 1) * np.pi
    latitude = ((v - SKIN_V[0]) / (SKIN_V[1] - SKIN_V[0]) - 0.5) * np.pi
    lon, lat = np.meshgrid(longitude, latitude)
    return lon, lat


def test_normals_of_the_sphere(chart: Chart) -> None:
    inside = _skin_interior(chart)
    outward = (chart.interpolate(chart.head.mean) - CENTRE)[inside]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", chart.normals(chart.head.mean)[inside], outward).min() > 0.999


def test_frame_is_orthonormal_right_handed_and_up_is_up(chart: Chart) -> None:
    frame = chart.frame(chart.head.mean)
    axes = np.stack([frame.tangent, frame.bitangent, frame.normal], -2)
    assert np.allclose(axes @ axes.swapaxes(-1, -2), np.eye(3), atol=1e-5)
    assert np.allclose(np.linalg.det(axes), 1, atol=1e-5)
    inside = _skin_interior(chart)
    lon, lat = _longitude_latitude(chart)
    east = np.stack([np.cos(lon), np.zeros_like(lon), -np.sin(lon)], -1)
    north = np.stack([-np.sin(lat) * np.sin(lon), np.cos(lat), -np.sin(lat) * np.cos(lon)], -1)
    assert np.sum(frame.tangent * east, -1)[inside].min() > 0.99
    assert np.sum(frame.bitangent * north, -1)[inside].min() > 0.99


def test_metric_of_the_sphere(chart: Chart) -> None:
    """E = (R cos(lat) dlon/du)^2, F = 0, G = (R dlat/dv)^2, per texel and in mm."""
    _, lat = _longitude_latitude(chart)
    inside = (chart.part == 0) & (np.abs(lat) < 0.7)
    e, f, g = np.moveaxis(chart.metric(chart.head.mean), -1, 0)
    around = 1000 * RADIUS * 2 * np.pi / (SKIN_U[1] - SKIN_U[0]) / WIDTH
    upward = 1000 * RADIUS * np.pi / (SKIN_V[1] - SKIN_V[0]) / HEIGHT
    assert np.allclose(np.sqrt(e[inside]), around * np.cos(lat)[inside], rtol=0.08)
    assert np.allclose(np.sqrt(g[inside]), upward, rtol=0.03)
    assert np.abs(f[inside]).max() < 0.06 * around * upward


def test_chart_is_mirror_symmetric(chart: Chart) -> None:
    position = chart.interpolate(chart.head.mean)
    other = mirrored_map(chart.mask).astype(bool)
    both = chart.mask & other
    assert (chart.mask != other).sum() < 0.02 * chart.mask.sum()
    assert np.abs(mirrored_map(position) * [-1, 1, 1] - position)[both].max() < 2e-3


def test_frame_survives_a_collapsed_head(chart: Chart) -> None:
    """All vertices in one point: no normals, no tangents, no area. Nothing may become NaN."""
    flat = np.zeros_like(chart.head.mean)
    frame = chart.frame(flat)
    axes = np.stack([frame.tangent, frame.bitangent, frame.normal], -2)
    assert np.allclose(axes @ axes.swapaxes(-1, -2), np.eye(3), atol=1e-5)
    assert np.array_equal(chart.metric(flat), np.zeros((HEIGHT, WIDTH, 3)))


def test_fill_outside_takes_the_nearest_inside(chart: Chart) -> None:
    image = np.where(chart.mask, 7, 0).astype(np.uint8)
    assert (chart.fill_outside(image) == 7).all()
    mask = np.zeros((9, 9), bool)
    mask[4, [2, 6]] = True
    nearest = nearest_inside(mask)
    assert (nearest[:, :4] == 4 * 9 + 2).all()
    assert (nearest[:, 5:] == 4 * 9 + 6).all()


def test_affine_maps_and_their_degenerate_case() -> None:
    source = np.array([[[0, 0], [2, 0], [0, 4]], [[1, 1], [1, 1], [1, 1]]], float)
    target = np.array([[[5, 5], [7, 9], [5, 9]], [[0, 0], [1, 1], [2, 0]]], float)
    along_x, along_y = solve_affine(source, target)
    assert np.allclose(along_x, [[1, 2], [0, 0]])
    assert np.allclose(along_y, [[0, 1], [0, 0]])


def test_nothing_inside_or_nothing_outside_changes_nothing() -> None:
    own = np.arange(12).reshape(3, 4)
    assert np.array_equal(nearest_inside(np.zeros((3, 4), bool)), own)
    assert np.array_equal(nearest_inside(np.ones((3, 4), bool)), own)
