"""The fit on readings made from the head itself, where the truth is known, and on every way they go bad."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.arrays import Float64
from service.face.finder import Face
from service.face.fit.dense import DenseTerms, correspondences, normal_derivative
from service.face.fit.fit import FitSettings
from service.face.fit.fit_face import fit_views, placing
from service.face.fit.landmark_fit import LandmarkModel, extended, identity_of
from service.face.fit.solver import POSE, State, System
from service.face.reading.openings import EYE, STATIONS, Opening
from service.face.reading.part_labels import PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading, View, crop_of
from service.geometry.camera import Camera, ahead, exp_rotation
from service.geometry.mesh import area_normals, normalise
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.head.regions import lid_edges
from service.photo.photo import Photo
from tests.support.fits import fit_face

SIZE, FOCAL = 512, 1100.0
MIDDLE = np.array([SIZE / 2, SIZE / 2])


@pytest.fixture(scope="module")
def wide(head: HeadModel) -> HeadModel:
    return extended(head, 80, 150)


def camera_at(yaw: float, focal: float) -> Camera:
    turn = exp_rotation(np.radians([0.0, yaw, 0.0]))
    return Camera(SIZE, SIZE, focal, MIDDLE, np.diag([1.0, -1.0, -1.0]) @ turn, np.array([0.01, -0.02, focal / 1100]))


def seen(head: HeadModel, vertices: Float64, yaw: float = 10.0, focal: float = FOCAL) -> tuple[Face, Photo, Reading]:
    """The landmarks of a head in a known pose, a grey photo, and what a perfect reader says of it."""
    camera = camera_at(yaw, focal)
    corners = vertices[head.triangles[head.landmark_triangle]]
    points = (corners * head.landmark_barycentric[..., None]).sum(1)
    depth = camera.to_camera(points)[:, 2:]
    at = np.concatenate([camera.project(points), (depth - depth.mean()) * focal / camera.translation[2]], 1)
    face = Face(np.array([0.0, 0.0, SIZE, SIZE]), 1.0, np.zeros((6, 2)), at, 1.0)
    region = crop_of(at)
    assert region is not None
    # The cells' middles are pixels of a raster whose pixels are the cells.
    projected = region.to_crop(camera.project(vertices), CELLS)
    depth = camera.to_camera(vertices)[:, 2]
    raster = rasterise(projected, depth, head.triangles, CELLS, CELLS, perspective=True)
    skin = raster.mask.copy()
    skin[raster.mask] = head.triangle_part[raster.triangle[raster.mask]] == 0
    weights = raster.barycentric[skin][..., None]
    chart, normal = np.full((CELLS, CELLS, 2), 0.5), np.tile([0.0, 0.0, -1.0], (CELLS, CELLS, 1))
    chart[skin] = (head.uv[head.triangle_uv[raster.triangle[skin]]] * weights).sum(1)
    turned = area_normals(vertices, head.triangles).astype(np.float64) @ camera.rotation.T
    there = (turned[head.triangles[raster.triangle[skin]]] * weights).sum(1)
    ray = np.array([*(np.array([region.x, region.y]) - MIDDLE) / focal, 1.0])
    normal[skin] = there / np.linalg.norm(there, axis=1, keepdims=True) @ ahead(ray).T
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    big = np.kron(skin, np.ones((2, 2))) > 0
    parts[..., 0], parts[..., SKIN] = ~big, big
    grid = np.full((CELLS, CELLS), 0.4)
    reading = Reading(region, chart, grid, normal, np.where(skin, 0.03, 1e3), parts)
    return face, Photo(np.full((SIZE, SIZE, 3), 128, np.uint8)), reading


def somebody(head: HeadModel, seed: int = 4) -> Float64:
    rng = np.random.default_rng(seed)
    return np.asarray(head.shape(rng.normal(size=60)), np.float64)


def error_mm(head: HeadModel, found: np.ndarray, truth: Float64) -> float:
    """Median over the face after the best similarity: the photo does not tell the size."""
    face = head.region("face") > 0.5
    a, b = found[face].astype(float), truth[face]
    a, b = a - a.mean(0), b - b.mean(0)
    u, s, vt = np.linalg.svd(a.T @ b)
    scale = s.sum() / (a**2).sum()
    return 1e3 * float(np.median(np.linalg.norm(scale * a @ u @ vt - b, axis=1)))


@pytest.mark.parametrize("yaw", [0.0, 25.0, 60.0])
def test_a_perfect_reading_brings_the_shape_back(head: HeadModel, yaw: float) -> None:
    """What no landmark shows: without the reading the error is several times as large."""
    truth = somebody(head)
    face, photo, reading = seen(head, truth, yaw)
    points = fit_face(face, photo, head, FitSettings(refine="landmarks"))
    dense = fit_face(face, photo, head, FitSettings(refine="dense"), reading)
    assert "not-read" not in dense.warnings
    assert error_mm(head, dense.neutral, truth) < min(1.2, 0.6 * error_mm(head, points.neutral, truth))


def test_a_profile_that_is_read_wrong_leaves_the_shape_to_the_other_photos(head: HeadModel) -> None:
    """The reader sees the average head in every profile, where it errs most."""
    truth = somebody(head)
    views = [View(photo, face, reading) for face, photo, reading in (seen(head, truth, yaw) for yaw in (0.0, 30.0))]
    face, photo, reading = seen(head, head.mean.astype(np.float64), 76.0)
    two, three = (fit_views(chosen, head)[0] for chosen in (views, [*views, View(photo, face, reading)]))
    errors = [error_mm(head, one.neutral, truth) for one in (two, three)]
    assert errors[1] < 1.1 * errors[0], errors


def with_skin(head: HeadModel, vertices: Float64, yaw: float) -> Photo:
    """The photo of :func:`seen` in which the skin has fine waves."""
    camera = camera_at(yaw, FOCAL)
    depth = camera.to_camera(vertices)[:, 2]
    raster = rasterise(camera.project(vertices), depth, head.triangles, SIZE, SIZE, perspective=True)
    corners = head.mean[head.triangles[raster.triangle[raster.mask]]]
    place = (corners * raster.barycentric[raster.mask][..., None]).sum(1)
    waves = np.sin(place @ np.array([[700, 200, 0], [-300, 600, 200], [150, -800, 400]]).T).sum(1)
    grey = np.full((SIZE, SIZE), 40.0)
    grey[raster.mask] = 130.0 * (1 + 0.12 * waves)
    return Photo(np.repeat(grey[..., None], 3, 2).astype(np.uint8))


def test_what_is_read_wrong_alike_in_all_photos_yields_to_the_spots_that_they_share(head: HeadModel) -> None:
    """The reader sees the average head in every photo."""
    truth, average = somebody(head), head.mean.astype(np.float64)
    views = []
    for yaw in (-30.0, 0.0, 30.0):
        face, grey, _ = seen(head, truth, yaw)
        views.append((face, grey, with_skin(head, truth, yaw), seen(head, average, yaw)[2]))
    even = fit_views([View(grey, face, reading) for face, grey, _, reading in views], head)[0]
    shared = fit_views([View(skin, face, reading) for face, _, skin, reading in views], head)[0]
    errors = [error_mm(head, one.neutral, truth) for one in (even, shared)]
    assert errors[1] < 0.8 * errors[0], errors


def test_a_photo_that_only_places_the_head_moves_no_coefficient_of_the_shape(wide: HeadModel) -> None:
    truth = somebody(wide)
    _, _, reading = seen(wide, truth)
    model, camera = LandmarkModel(wide, len(wide.identity)), camera_at(8.0, FOCAL)
    state = State(camera.rotation, camera.translation[:2], np.log(FOCAL), 0.0, np.full(model.shape_count, 0.1))
    dense = DenseTerms(wide, correspondences(wide, reading, state, MIDDLE))
    for term in (dense.points(state), dense.normals(state, truth)):
        heard = System.of([term], state)
        silent = System.of([placing(term, state, model.identity_count)], state)
        kept = np.r_[:POSE, POSE + model.identity_count : len(heard.gradient)]
        assert silent.gradient[kept] == pytest.approx(heard.gradient[kept], rel=1e-3, abs=1e-3)
        assert not silent.gradient[identity_of(model)].any() and not silent.hessian[identity_of(model)].any()
        assert heard.hessian[identity_of(model)].any()


def test_normals_bend_the_shape_where_places_are_vague(head: HeadModel) -> None:
    """Places alone leave the depth open; the switch that leaves normals out has to leave them out."""
    truth = somebody(head)
    face, photo, reading = seen(head, truth)
    vague = replace(reading, chart_mm=np.full_like(reading.chart_mm, 6.0))
    both = fit_face(face, photo, head, FitSettings(refine="dense"), vague)
    places = fit_face(face, photo, head, FitSettings(refine="dense", normals=False), vague)
    assert error_mm(head, both.neutral, truth) < 0.9 * error_mm(head, places.neutral, truth)
    turned = replace(vague, normal=vague.normal * [-1.0, 1.0, 1.0])
    assert np.array_equal(
        fit_face(face, photo, head, FitSettings(refine="dense", normals=False), turned).vertices, places.vertices
    )


def test_derivatives_are_those_of_finite_differences(wide: HeadModel) -> None:
    truth = somebody(wide)
    _, _, reading = seen(wide, truth)
    model = LandmarkModel(wide, len(wide.identity))
    rotation = np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.radians([3.0, 12.0, 1.0]))
    state = State(rotation, np.array([0.01, -0.02]), np.log(FOCAL), 0.0, np.zeros(model.shape_count))
    dense = DenseTerms(wide, correspondences(wide, reading, state, MIDDLE))
    for term in (dense.points(state), dense.normals(state, wide.mean)):
        n = POSE + model.shape_count
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        term.add(state, hessian, gradient)
        for k in (0, 1, 2, 3, 4, 5, 6, POSE, POSE + 50, POSE + 100, POSE + 200, n - 5):
            step = np.zeros(n)
            step[k] = 1e-5
            slope = (term.cost(state.stepped(step)) - term.cost(state.stepped(-step))) / 2e-5
            assert slope == pytest.approx(gradient[k], rel=2e-3, abs=1e-3 * np.abs(gradient).max())


def _constant(reading: Reading) -> Reading:
    return replace(reading, chart=np.full_like(reading.chart, 0.4), normal=reading.normal * 0 + [0.0, 0.0, -1.0])


BAD: dict[str, Callable[[Reading], Reading]] = {
    "NaN": lambda r: replace(r, chart=r.chart * np.nan, normal=r.normal * np.nan),
    "constant": _constant,
    "no skin": lambda r: replace(r, parts=np.roll(r.parts, 3, -1) * 0 + np.eye(len(PARTS), dtype=np.float32)[0]),
    "mirrored": lambda r: replace(r, chart=r.chart[:, ::-1]),
    "off the chart": lambda r: replace(r, chart=r.chart + 2.0),
}


@pytest.mark.parametrize("name", BAD)
def test_a_reading_that_is_not_understood_is_not_followed(head: HeadModel, name: str) -> None:
    """A network that fails must not bend the head: the landmarks decide, and the result says so."""
    face, photo, reading = seen(head, somebody(head))
    with_it = fit_face(face, photo, head, None, BAD[name](reading))
    without = fit_face(face, photo, head)
    assert "not-read" in with_it.warnings and "not-read" in without.warnings
    assert np.array_equal(with_it.vertices, without.vertices)


@pytest.mark.parametrize("value", [0.0, 1e-12, 1e6, np.inf])
def test_any_uncertainty_gives_a_head(head: HeadModel, value: float) -> None:
    """Zero would be an infinite weight, and a million none at all."""
    truth = somebody(head)
    face, photo, reading = seen(head, truth)
    odd = replace(reading, chart_mm=np.full_like(reading.chart_mm, value), normal_sine=reading.normal_sine * 0 + value)
    fit = fit_face(face, photo, head, None, odd)
    assert np.isfinite(fit.vertices).all() and error_mm(head, fit.neutral, truth) < 5.0


def test_an_infinite_focal_length(head: HeadModel) -> None:
    """A face a hundred metres away: the focal length is at its bound, and nothing overflows."""
    truth = somebody(head)
    face, photo, reading = seen(head, truth, focal=110_000.0)
    fit = fit_face(face, photo, head, None, reading)
    assert np.isfinite(fit.vertices).all() and error_mm(head, fit.neutral, truth) < 2.0


@pytest.mark.parametrize("side", ["right", "left"])
def test_lids_close_where_their_edges_meet(head: HeadModel, side: str) -> None:
    """Landmarks of an open eye, edges of a shut one: with the landmarks alone irises were painted on lids."""
    face, photo, reading = seen(head, np.asarray(head.mean, np.float64), yaw=0.0)
    corners = face.landmarks[list(EYE.corners[side]), :2]
    line = corners[0] + STATIONS[:, None] * (corners[1] - corners[0]) + [0.0, 1.0]
    shut = Opening(line, line, corners, np.full((2, 9), 0.01))
    opened, closed = (
        fit_face(face, photo, head, None, replace(reading, openings=openings)) for openings in ({}, {side: shut})
    )
    edges = lid_edges(head, side)
    assert edges is not None

    def height_mm(vertices: np.ndarray) -> float:
        upper = min(float(np.median(vertices[row, 1])) for row in edges.upper)
        return 1e3 * (upper - max(float(np.median(vertices[row, 1])) for row in edges.lower))

    assert height_mm(opened.vertices) > 4.0
    assert height_mm(closed.vertices) < 1.5


def test_derivative_of_normals() -> None:
    """A fan of triangles around one vertex; a second vertex has no area at all and must not give NaN."""
    ring = np.array([[np.cos(t), np.sin(t), 0.1 * np.sin(3 * t)] for t in np.linspace(0, 2 * np.pi, 6, endpoint=False)])
    vertices = np.vstack([[0.0, 0, 0.3], ring, [[5.0, 5, 5]] * 3])
    triangles = np.array([[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)] + [[7, 8, 9]], np.int32)
    moves = np.random.default_rng(9).normal(size=(4, len(vertices), 3)).astype(np.float32)
    moves[:, 7:] = 0

    def normal(v: np.ndarray) -> np.ndarray:
        p = v[triangles[:6]]
        return normalise(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]).sum(0))

    by_place = normal_derivative(vertices, triangles, np.array([0, 7])).toarray()
    found = (by_place @ moves.reshape(len(moves), -1).T).reshape(2, 3, -1)
    numeric = [(normal(vertices + 1e-6 * m) - normal(vertices - 1e-6 * m)) / 2e-6 for m in moves.astype(float)]
    np.testing.assert_allclose(found[0], np.stack(numeric, 1), atol=1e-5)
    assert not found[1].any()
