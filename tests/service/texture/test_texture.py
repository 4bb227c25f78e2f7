"""The texture of a head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.reading.part_labels import SCLERA
from service.face.reading.part_labels import SKIN as SKIN_READ
from service.geometry.chart import Chart, mirrored_map
from service.map_registry import MIRRORED, SEEN
from service.photo.photo import Photo
from service.texture.texture import Texture, make_texture
from tests.service.texture.scenes import SKIN, checks, fitted, one_sided_light, photograph, plain, read_off, turned
from tests.toyhead import SKIN_U, sphere_head

HEAD = sphere_head(40, 60)
CHART = Chart.build(HEAD, 288, 192)
POINTS = CHART.interpolate(HEAD.mean).astype(float)
SKIN_MASK = CHART.part == 0


def _texture(photo: Photo, yaw: float) -> Texture:
    return make_texture(photo, HEAD, fitted(HEAD, turned(yaw)), CHART, read_off(HEAD, turned(yaw), _parts))


def _parts(points: np.ndarray) -> np.ndarray:
    return np.where(_on_eye(points), SCLERA, SKIN_READ)


def _on_eye(points: np.ndarray) -> np.ndarray:
    eyes = [np.linalg.norm(points - [x, 0, 0], axis=1) < 0.0122 for x in (-0.031, 0.031)]
    return np.asarray(eyes[0] | eyes[1])


def _error(texture: Texture, where: np.ndarray, expected: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(texture.texture[where] / 255 - expected[where]).max(-1))


def test_constant_photo_gives_constant_skin() -> None:
    """Completion, mirroring, light matching and grain must all leave a uniform colour alone."""
    texture = _texture(Photo(np.full((400, 400, 3), [204, 158, 133], np.uint8)), 20.0)
    assert np.abs(texture.texture[SKIN_MASK].astype(int) - [204, 158, 133]).max() <= 1


def test_checks_come_back_where_they_were_seen() -> None:
    texture = _texture(photograph(HEAD, turned(0), checks), 0)
    seen = SKIN_MASK & (texture.confidence >= 220)
    assert seen.sum() > 0.15 * SKIN_MASK.sum()
    error = _error(texture, seen, checks(POINTS.reshape(-1, 3)).reshape(POINTS.shape))
    assert np.median(error) < 0.01
    assert np.mean(error > 0.1) < 0.12  # texels across an edge of the checks


def test_unseen_half_is_the_mirror_image() -> None:
    texture = _texture(photograph(HEAD, turned(50), checks), 50)
    from_mirror = SKIN_MASK & (texture.confidence < SEEN) & (texture.confidence >= SEEN - 10)
    assert from_mirror.sum() > 500
    error = _error(texture, from_mirror, checks(POINTS.reshape(-1, 3)).reshape(POINTS.shape))
    assert np.median(error) < 0.02
    assert np.mean(error > 0.1) < 0.15


def test_mirrored_side_continues_the_light_of_its_surroundings() -> None:
    """The head's right is darker and alone in sight; unmatched, its mirror image would darken the left as well."""
    texture = _texture(photograph(HEAD, turned(30), one_sided_light), 30)
    truth = one_sided_light(POINTS.reshape(-1, 3)).reshape(POINTS.shape)
    from_mirror = SKIN_MASK & (texture.confidence < SEEN) & (texture.confidence >= 40)
    near = from_mirror & (POINTS[..., 0] > 0.02) & (POINTS[..., 0] < 0.06)
    assert near.sum() > 200
    unmatched = np.abs(mirrored_map(truth)[near] - truth[near]).max(-1).mean()
    assert unmatched > 0.2
    assert _error(texture, near, truth).mean() < 0.5 * unmatched
    step = np.abs(np.diff(texture.texture[..., 0].astype(float) / 255, axis=1))
    assert step[from_mirror[:, 1:] & SKIN_MASK[:, :-1]].max() < 0.05


def test_background_does_not_reach_the_skin() -> None:
    """A fit that is 5 mm too large all round reads the green wall at its rim, at angles that count."""
    photo = photograph(HEAD, turned(0), plain(SKIN))
    larger = (HEAD.mean * np.float32(1.06)).astype(np.float32)
    texture = make_texture(photo, HEAD, fitted(HEAD, turned(0), larger), CHART)
    skin = texture.texture[SKIN_MASK].astype(float) / 255
    assert np.abs(skin - SKIN).max() < 0.06


def test_an_eye_does_not_print_itself_on_the_skin_behind_it() -> None:
    """Without the z-test the texels of the sphere within the eyeball would show the eyeball."""

    def paint(points: np.ndarray) -> np.ndarray:
        return np.where(_on_eye(points)[:, None], [0.0, 0.0, 1.0], SKIN)

    texture = _texture(photograph(HEAD, turned(0), paint), 0)
    blue = texture.texture[..., 2].astype(float) - texture.texture[..., 0]
    assert blue[SKIN_MASK].max() < 40
    eyes = (CHART.part == 1) | (CHART.part == 2)
    assert np.percentile(blue[eyes & (texture.confidence > 240)], 5) > 100


def test_the_back_meets_itself() -> None:
    """Left and right end of the chart are the same points of the head: no jump across the cut."""
    texture = _texture(photograph(HEAD, turned(40), one_sided_light), 40).texture.astype(int)
    left, right = (round(u * CHART.width) for u in SKIN_U)
    rows = np.flatnonzero(SKIN_MASK[:, CHART.width // 2])[15:-15]
    assert np.abs(texture[rows, left + 1] - texture[rows, right - 2]).max() <= 6


@pytest.mark.parametrize("yaw", [0.0, 45.0, 75.0, 90.0, -90.0, 180.0])
def test_every_turn_gives_full_finite_maps(yaw: float) -> None:
    texture = _texture(photograph(HEAD, turned(yaw), checks), yaw)
    _require_sound(texture)


def _require_sound(texture: Texture) -> None:
    shape = (CHART.height, CHART.width)
    assert texture.texture.shape == (*shape, 3)
    assert texture.texture.dtype == texture.confidence.dtype == np.uint8
    for normal in (texture.shape_normal_object, texture.shape_normal_tangent):
        assert normal.dtype == np.float32
        assert np.allclose(np.linalg.norm(normal, axis=-1), 1, atol=1e-4)
    assert texture.shape_normal_tangent[..., 2].min() > 0
    assert np.isfinite(texture.depth).all()
    assert np.array_equal(texture.mask, CHART.mask)
    assert 0 <= texture.visible_fraction <= 1
    assert texture.texture[..., 0].min() > 0  # no black hole anywhere, not even beside the islands


def test_nothing_seen_is_complete_and_says_so() -> None:
    """The head lies outside the photo: default colours, confidence 0 everywhere."""
    camera = turned(0)
    away = replace(camera, principal_point=np.array([-5000.0, -5000.0]))
    texture = make_texture(Photo(np.zeros((400, 400, 3), np.uint8)), HEAD, fitted(HEAD, away), CHART)
    _require_sound(texture)
    assert not texture.confidence.any()
    assert texture.visible_fraction == 0
    assert texture.warnings == ("little-seen", "not-segmented")


@pytest.mark.parametrize("depth", [-1.0, 0.02])
def test_a_camera_behind_or_within_the_head_gives_finite_maps(depth: float) -> None:
    """Vertices on both sides of the camera project to wild places."""
    camera = replace(turned(0), translation=np.array([0.0, 0.0, depth]))
    texture = make_texture(Photo(np.full((400, 400, 3), 99, np.uint8)), HEAD, fitted(HEAD, camera), CHART)
    _require_sound(texture)
    assert depth > 0 or texture.visible_fraction == 0


def test_zero_area_triangles_are_harmless() -> None:
    """A quarter of the head collapsed into one point: no normals, no area, no Jacobian there."""
    vertices = HEAD.mean.copy()
    vertices[: len(vertices) // 4] = vertices[0]
    photo = photograph(HEAD, turned(0), checks)
    _require_sound(make_texture(photo, HEAD, fitted(HEAD, turned(0), vertices), CHART))


def test_face_half_outside_the_photo() -> None:
    camera = replace(turned(0), principal_point=np.array([0.0, 200.0]))
    texture = make_texture(photograph(HEAD, camera, checks), HEAD, fitted(HEAD, camera), CHART)
    _require_sound(texture)
    seen = (texture.confidence >= SEEN) & SKIN_MASK
    assert POINTS[..., 0][seen].min() > -0.002


def test_confidence_has_three_bands() -> None:
    texture = _texture(photograph(HEAD, turned(35), checks), 35)
    facing = CHART.normals(HEAD.mean) @ turned(35).centre
    code = texture.confidence
    assert facing[SKIN_MASK & (code >= 250)].min() > facing[SKIN_MASK & (code < SEEN)].min()
    assert (code[SKIN_MASK & (POINTS[..., 2] < -0.15)] == 0).all()
    reflected = SKIN_MASK & (code < SEEN) & (code >= MIRRORED)
    assert (POINTS[..., 0][reflected] > 0.0).mean() > 0.9
    assert (mirrored_map(code)[reflected] >= SEEN).mean() > 0.9


def test_grey_photo_gives_grey_maps_also_where_made_up() -> None:
    def paint(points: np.ndarray) -> np.ndarray:
        return np.broadcast_to(checks(points).mean(1, keepdims=True), (len(points), 3))

    texture = _texture(photograph(HEAD, turned(0), paint, (0.4, 0.4, 0.4)), 0).texture.astype(int)
    assert (texture.max(-1) - texture.min(-1)).max() <= 2


def test_same_input_same_bytes() -> None:
    photo = photograph(HEAD, turned(15), checks)
    first, second = _texture(photo, 15), _texture(photo, 15)
    assert np.array_equal(first.texture, second.texture)
    assert np.array_equal(first.confidence, second.confidence)
    assert np.array_equal(first.shape_normal_tangent, second.shape_normal_tangent)


@pytest.mark.parametrize("field", ["vertices", "focal", "translation"])
def test_a_fit_that_is_not_finite_is_refused_by_name(field: str) -> None:
    fit = fitted(HEAD, turned(0))
    if field == "vertices":
        broken = HEAD.mean.copy()
        broken[7, 1] = np.nan
        fit = replace(fit, vertices=broken)
    elif field == "focal":
        fit = replace(fit, camera=replace(fit.camera, focal_px=float("inf")))
    else:
        fit = replace(fit, camera=replace(fit.camera, translation=np.array([0, 0, np.nan])))
    with pytest.raises(NumericFault, match=field):
        make_texture(Photo(np.zeros((400, 400, 3), np.uint8)), HEAD, fit, CHART)


def test_visible_fraction_of_a_hidden_and_an_open_face() -> None:
    photo = photograph(HEAD, turned(0), plain(SKIN))
    frontal, averted = (_texture(photo, yaw).visible_fraction for yaw in (0, 180))
    assert frontal > 0.75
    assert averted < 0.02
