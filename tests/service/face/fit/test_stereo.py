"""Spots that two photos of one head share, on a head of the model with a painted skin, where the truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from service.arrays import Float64, UInt8
from service.face.fit.landmark_fit import LandmarkModel
from service.face.fit.solver import POSE, State, System, project_points
from service.face.fit.stereo import Picture, pairs, stereo_terms, tracks
from service.geometry.camera import exp_rotation
from service.geometry.mesh import vertex_normals
from service.geometry.raster import rasterise
from service.head.model import HeadModel

SIZE, SCALE = 480, 1900.0
MIDDLE = np.array([SIZE / 2, SIZE / 2])


def state_of(head: HeadModel, yaw: float, coefficients: Float64) -> State:
    rotation = np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.radians([0.0, yaw, 0.0]))
    return State(rotation, np.zeros(2), float(np.log(SCALE)), 0.1, coefficients)


def shape(head: HeadModel, state: State) -> Float64:
    return head.shape(*np.split(state.coefficients, [len(head.identity)])).astype(np.float64)


def photo_of(head: HeadModel, state: State, light: float, contrast: float = 0.12, lamp: float = 0.0) -> UInt8:
    """A head whose skin has fine waves, dark or bright; a lamp beside it, at -1 or 1, leaves one side in shade."""
    vertices = shape(head, state)
    seen = project_points(state, vertices)
    raster = rasterise(seen.uv + MIDDLE, seen.position[:, 2], head.triangles, SIZE, SIZE, perspective=True)
    hit = raster.mask
    place = (head.mean[head.triangles[raster.triangle[hit]]] * raster.barycentric[hit][..., None]).sum(1)
    waves = np.sin(place @ np.array([[900, 300, 0], [-400, 800, 300], [200, -1100, 500]]).T).sum(1)
    image = np.full((SIZE, SIZE, 3), 40.0)
    normals = vertex_normals(vertices, head.triangles)[head.triangles[raster.triangle[hit]]]
    beside = (normals * raster.barycentric[hit][..., None]).sum(1) @ np.array([lamp, 0.0, 0.8]) / np.hypot(lamp, 0.8)
    shade = 0.3 + 1.2 * np.maximum(beside, 0) if lamp else np.ones(len(place))
    image[hit] = (light * shade * (1 + contrast * waves))[:, None]
    return np.asarray(np.clip(image, 0, 255), np.uint8)


def depth_of(head: HeadModel, coefficients: Float64) -> Float64:
    """(SIZE, SIZE) metres, from in front; nan beside the face."""
    state = state_of(head, 0.0, coefficients)
    seen = project_points(state, shape(head, state))
    face = head.triangles[(head.region("face") > 0.5)[head.triangles].all(1)]
    raster = rasterise(seen.uv + MIDDLE, seen.position[:, 2], face, SIZE, SIZE, perspective=True)
    return np.where(raster.mask, raster.depth, np.nan).astype(np.float64)


def coefficients_of(head: HeadModel, seed: int) -> Float64:
    identity = np.random.default_rng(seed).normal(size=len(head.identity)) * 0.8
    return np.concatenate([identity, np.zeros(len(head.expression))])


def test_spots_lie_on_each_other_where_the_head_is_right(head: HeadModel) -> None:
    """In other light too: mean and contrast are taken out."""
    states = [state_of(head, yaw, coefficients_of(head, 1)) for yaw in (0.0, 30.0)]
    made = [
        Picture.of(photo_of(head, state, light), MIDDLE, head, state, shape(head, state))
        for state, light in zip(states, (150.0, 70.0), strict=True)
    ]
    assert made[0] is not None and made[1] is not None
    found = tracks(head, made[0], made[1])
    assert found is not None and len(found.trust) > 100
    places = (made[0].vertices[found.corners] * found.weights[..., None]).sum(1)
    for state, pixels in zip(states, found.pixels, strict=True):
        off = np.linalg.norm(project_points(state, places).uv - pixels, axis=1) / SCALE
        assert np.median(off) < 0.3e-3


def test_shade_is_not_followed_on_almost_even_skin(head: HeadModel) -> None:
    """Where light moves from photo to photo and skin shows little, spots are few and wrong if shade is compared."""
    states = [state_of(head, yaw, coefficients_of(head, 1)) for yaw in (0.0, 30.0)]
    one, other = (
        Picture.of(photo_of(head, state, 110.0, 0.015, lamp), MIDDLE, head, state, shape(head, state))
        for state, lamp in zip(states, (-1.0, 1.0), strict=True)
    )
    assert one is not None and other is not None
    found = tracks(head, one, other)
    assert found is not None and found.trust.sum() > 400
    places = (one.vertices[found.corners] * found.weights[..., None]).sum(1)
    off = np.linalg.norm(project_points(states[1], places).uv - found.pixels[1], axis=1) / SCALE
    assert np.percentile(off, 90) < 1.5e-3


def test_spots_pull_a_wrong_head_towards_the_right_one(head: HeadModel) -> None:
    """The shape that they ask for, near the average, is nearer to the truth in depth than the average is.

    Spots tell where both rays meet, not which vertex lies there, so that depth is compared and not vertices.
    """
    truth, average = coefficients_of(head, 1), np.zeros(LandmarkModel(head, len(head.identity)).shape_count)
    photos = [photo_of(head, state_of(head, yaw, truth), 130.0) for yaw in (0.0, 30.0)]

    def pictures(coefficients: Float64) -> list[Picture]:
        states = [state_of(head, yaw, coefficients) for yaw in (0.0, 30.0)]
        made = [Picture.of(photo, MIDDLE, head, at, shape(head, at)) for photo, at in zip(photos, states, strict=True)]
        return [picture for picture in made if picture is not None]

    seen = pictures(average)
    terms = stereo_terms(head, seen)
    assert all(len(one) == 1 for one in terms)
    systems = [System.of(own, picture.state) for own, picture in zip(terms, seen, strict=True)]
    hessian = sum(one.hessian[POSE:, POSE:] for one in systems) + np.eye(len(average))
    step = -np.linalg.solve(hessian, sum(one.gradient[POSE:] for one in systems))
    step[len(head.identity) :] = 0.0
    right, wrong, pulled = (depth_of(head, shown) for shown in (truth, average, average + step))
    off = [float(np.nanmean(np.abs(one - right))) for one in (wrong, pulled)]
    assert off[1] < 0.8 * off[0], off


def test_profiles_are_compared_with_no_photo_and_of_one_direction_only_the_most_evenly_lit(head: HeadModel) -> None:
    """A head is placed some degrees off in a profile; compared with the rest, it would pull their shape along."""
    states = [state_of(head, yaw, coefficients_of(head, 1)) for yaw in (0.0, 3.0, 35.0, 60.0, 78.0)]
    assert pairs(states, [0.1, 0.2, 0.3, 0.3, 0.1]) == [(0, 2), (2, 3)]
    assert pairs(states, [0.2, 0.1, 0.3, 0.3, 0.1]) == [(1, 2), (2, 3)]
    assert pairs(states[-1:], [0.1]) == pairs([], []) == []


def test_hard_light_is_uneven_in_a_dim_photo_too(head: HeadModel) -> None:
    state = state_of(head, 0.0, coefficients_of(head, 1))
    even, hard = photo_of(head, state, 150.0), photo_of(head, state, 30.0)
    hard[:, : SIZE // 2] = hard[:, : SIZE // 2] // 2
    pictures = [Picture.of(photo, MIDDLE, head, state, shape(head, state)) for photo in (even, hard)]
    assert pictures[0] is not None and pictures[1] is not None
    assert pictures[1].uneven > 2 * pictures[0].uneven


@pytest.mark.parametrize("light", [0.0, 128.0])
def test_photos_of_nothing_share_no_spots(head: HeadModel, light: float) -> None:
    """Contrast is divided by: that of even skin is 0."""
    states = [state_of(head, yaw, coefficients_of(head, 1)) for yaw in (0.0, 30.0)]
    blank = np.full((SIZE, SIZE, 3), light, np.uint8)
    pictures = [Picture.of(blank, MIDDLE, head, state, shape(head, state)) for state in states]
    assert not any(stereo_terms(head, pictures))


def test_a_face_beside_the_photo_is_no_picture(head: HeadModel) -> None:
    state = state_of(head, 0.0, coefficients_of(head, 1))
    away = State(state.rotation, np.array([5.0, 0.0]), state.log_scale, state.log_distance, state.coefficients)
    assert Picture.of(np.zeros((SIZE, SIZE, 3), np.uint8), MIDDLE, head, away, shape(head, away)) is None
