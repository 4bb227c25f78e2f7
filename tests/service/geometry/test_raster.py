"""The z-buffer against closed forms and an independent point-in-triangle test.

Sampling against closed forms: what a pixel is, what an area is, what happens at the border.
"""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.raster import FARTHEST_PX, fragments, rasterise, transmittances
from service.geometry.sampling import Pyramid


def _square(x0: float, y0: float, x1: float, y1: float) -> tuple[np.ndarray, np.ndarray]:
    points = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return points, np.array([[0, 2, 1], [0, 3, 2]])


def _random_soup(seed: int, count: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-10, 60, (count * 3, 2))
    return points, rng.uniform(1, 5, count * 3), np.arange(count * 3).reshape(-1, 3)


def _reference(points: np.ndarray, depth: np.ndarray, triangles: np.ndarray, width: int, height: int) -> np.ndarray:
    """Depth by brute force: every triangle's edge functions at every pixel."""
    y, x = np.mgrid[:height, :width] + 0.5
    nearest = np.full((height, width), np.inf)
    for t in triangles:
        matrix = np.vstack([points[t].T, np.ones(3)])
        weights = np.linalg.solve(matrix, np.stack([x.ravel(), y.ravel(), np.ones(x.size)])).reshape(3, height, width)
        inside = (weights >= 0).all(0)
        z = np.einsum("k,khw->hw", depth[t], weights)
        nearest = np.where(inside & (z < nearest), z, nearest)
    return nearest


def test_corners_far_outside_the_picture() -> None:
    """In single precision a corner 1e12 pixels away made the whole triangle vanish, and one of 1e39 overflowed."""
    for far in (1e3, 1e6, 1e8, 1e12, 1e39, 1e200):
        points = np.array([[-far, -far], [far, -far], [0, far]])
        drawn = rasterise(points, np.array([1.0, 2.0, 3.0]), np.array([[0, 2, 1]]), 20, 16, perspective=True)
        assert drawn.mask.all() if far < FARTHEST_PX else not drawn.mask.any()
        assert np.isfinite(drawn.barycentric).all()


@pytest.mark.parametrize("gap", [1e-3, 1e-5])
def test_layers_close_to_each_other_before_something_far(gap: float) -> None:
    points, triangles = _square(0, 0, 40, 40)
    tilt = np.array([0.0, 0.1, 0.1, 0.0])
    depth = np.concatenate([0.6 + gap + tilt, 0.6 + tilt, np.full(4, 30.0)])
    layers = np.concatenate([triangles, triangles + 4, triangles + 8])
    drawn = rasterise(np.tile(points, (3, 1)), depth, layers, 40, 40, perspective=True)
    assert np.isin(drawn.triangle, [2, 3]).all()


def test_agrees_with_brute_force() -> None:
    points, depth, triangles = _random_soup(1)
    raster = rasterise(points, depth, triangles, 50, 40)
    expected = _reference(points, depth, triangles, 50, 40)
    assert np.array_equal(np.isfinite(raster.depth), np.isfinite(expected))
    assert np.allclose(raster.depth[raster.mask], expected[raster.mask], atol=1e-5)


def test_barycentric_gives_back_the_pixel_centre() -> None:
    points, depth, triangles = _random_soup(2)
    raster = rasterise(points, depth, triangles, 50, 40)
    corners = points[triangles[raster.triangle[raster.mask]]]
    at = np.einsum("nk,nki->ni", raster.barycentric[raster.mask], corners)
    row, column = np.nonzero(raster.mask)
    assert np.allclose(at, np.stack([column, row], 1) + 0.5, atol=1e-4)


def test_nearer_triangle_hides_and_tie_goes_to_the_lower_index() -> None:
    points, quad = _square(0, 0, 8, 8)
    both, triangles = np.vstack([points, points]), np.vstack([quad, quad + 4])
    depth = np.r_[np.full(4, 2.0), np.full(4, 1.0)]
    assert (rasterise(both, depth, triangles, 8, 8).triangle >= 2).all()
    assert (rasterise(both, np.ones(8), triangles, 8, 8).triangle < 2).all()


def test_perspective_interpolation_is_linear_in_space() -> None:
    """A floor that runs away from the camera: depth along it is f * h / y, which a linear depth would miss by far."""
    focal, drop = 100.0, 1.0
    corners = np.array([[-8.0, drop, 2.0], [8.0, drop, 2.0], [8.0, drop, 20.0], [-8.0, drop, 20.0]])
    points = focal * corners[:, :2] / corners[:, 2:] + [32.0, 0.0]
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    raster = rasterise(points, corners[:, 2], triangles, 64, 50, perspective=True)
    row, _ = np.nonzero(raster.mask)
    assert np.allclose(raster.depth[raster.mask], focal * drop / (row + 0.5), rtol=1e-5)
    z = np.einsum("nk,nk->n", raster.barycentric[raster.mask], corners[:, 2][triangles[raster.triangle[raster.mask]]])
    assert np.allclose(z, focal * drop / (row + 0.5), rtol=1e-4)


@pytest.mark.parametrize(
    "bad",
    [
        [[1, 1], [5, 5], [5, 5]],
        [[1, 1], [3, 3], [6, 6]],
        [[np.nan, 1], [5, 5], [1, 5]],
        [[np.inf, 1], [5, 5], [1, 5]],
        [[1e300, 1], [-1e300, 5], [1, 1e300]],
        [[100, 100], [120, 100], [100, 120]],
        [[-1, -1], [-9, -1], [-1, -9]],
    ],
    ids=["zero edge", "on a line", "nan", "inf", "overflow", "off right", "off left"],
)
def test_useless_triangles_draw_nothing_and_harm_nothing(bad: list[list[float]]) -> None:
    """Any of these, divided by its area or cast to a pixel, would give NaN or a wild index."""
    points, quad = _square(0, 0, 8, 8)
    with_bad = np.vstack([points, np.array(bad, float)])
    triangles = np.vstack([[[4, 5, 6]], quad])
    depth = np.r_[np.ones(4), np.full(3, 0.5)]
    raster = rasterise(with_bad, depth, triangles, 8, 8)
    assert (raster.triangle >= 1).all()
    assert np.isfinite(raster.barycentric).all()


def test_sliver_that_is_almost_a_line_keeps_weights_and_depth_in_range() -> None:
    points = np.array(
        [[0.0, 0.5], [20.0, 0.5 + 1e-13], [20.0, 0.5 - 1e-13], [0.0, 3.0], [20.0, 3.0 + 1e-310], [9.0, 3.5]]
    )
    raster = rasterise(points, np.array([1.0, 2.0, 3.0, 1.0, 2.0, 3.0]), np.array([[0, 1, 2], [3, 4, 5]]), 20, 4)
    assert np.isfinite(raster.barycentric).all()
    assert (raster.barycentric >= 0).all()
    assert ((raster.depth[raster.mask] >= 1) & (raster.depth[raster.mask] <= 3)).all()


def test_layers_are_composited_as_one_by_one() -> None:
    rng = np.random.default_rng(1)
    pixel = np.sort(rng.integers(0, 20, 200))
    colour, alpha = rng.uniform(0, 1, (200, 3)), rng.uniform(0, 1, 200)
    wanted = np.zeros((20, 4))
    for p, c, a in zip(pixel[::-1], colour[::-1], alpha[::-1], strict=True):  # the furthest first
        wanted[p] = a * np.array([*c, 1.0]) + (1 - a) * wanted[p]
    share = transmittances(pixel, alpha) * alpha
    planes = [np.bincount(pixel, share * plane, 20) for plane in (*colour.T, np.ones(200))]
    np.testing.assert_allclose(np.stack(planes, 1), wanted, atol=1e-5)


def test_fragments_are_all_surfaces_by_triangles() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-5, 25, (30, 2))
    depth, triangles = rng.uniform(0.5, 2.0, 30), rng.integers(0, 30, (40, 3))
    found = fragments(points, depth, triangles, 20, 16)
    assert (np.diff(found.triangle) >= 0).all()
    nearest = rasterise(points, depth, triangles, 20, 16, perspective=True)
    least = np.full(20 * 16, np.inf, np.float32)
    np.minimum.at(least, found.pixel, found.depth)
    assert np.array_equal(np.isfinite(least), nearest.mask.ravel())
    seen = np.flatnonzero(nearest.mask)
    np.testing.assert_allclose(least[seen], nearest.depth.ravel()[seen], rtol=1e-5)
    front = found.depth == least[found.pixel]
    wanted = nearest.barycentric.reshape(-1, 3)[found.pixel[front]]
    np.testing.assert_allclose(found.barycentric[front], wanted, atol=1e-5)
    shallow = fragments(points, depth, triangles, 20, 16, nearer=np.full((16, 20), 1.0, np.float32))
    assert len(shallow.pixel) == (found.depth < 1.0).sum() > 0
    assert not len(fragments(points + 1000, depth, triangles, 20, 16).pixel)


def test_nan_depth_and_points_behind_the_camera_are_left_out() -> None:
    points, quad = _square(0, 0, 8, 8)
    assert not rasterise(points, np.full(4, np.nan), quad, 8, 8).mask.any()
    assert not rasterise(points, np.array([-1.0, 1.0, 1.0, -1.0]), quad, 8, 8, perspective=True).mask.any()
    assert not rasterise(points, np.zeros(4), quad, 8, 8, perspective=True).mask.any()


def _ramp(width: int, height: int) -> np.ndarray:
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x, y], -1)


def test_a_linear_image_is_read_exactly_between_pixels() -> None:
    points = np.random.default_rng(0).uniform(1, 30, (200, 2))
    assert np.allclose(Pyramid.build(_ramp(40, 33)).sample(points), points, atol=0.04)


def test_border_repeats_and_wild_points_are_safe() -> None:
    pyramid = Pyramid.build(np.full((8, 8, 3), 0.25))
    points = np.array([[-1e9, 4], [1e9, 1e9], [np.nan, 2], [np.inf, -np.inf]])
    assert np.allclose(pyramid.sample(points, np.array([1, 1e9, np.nan, 2])), 0.25)


def test_more_points_than_the_library_takes_in_one_row() -> None:
    points = np.tile([[3.5, 2.5]], (70_000, 1))
    assert np.allclose(Pyramid.build(_ramp(8, 8)).sample(points), [3.5, 2.5])
