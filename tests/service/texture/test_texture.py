"""The texture of a head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.face.reading.part_labels import HAT, SCLERA
from service.face.reading.part_labels import SKIN as SKIN_READ
from service.geometry.chart import Chart
from service.map_registry import SEEN
from service.photo.photo import Photo
from service.texture.texture import Texture, Unwrappings, make_texture
from service.texture.unwrap import Zones
from tests.service.texture.scenes import SKIN, checks, fitted, photograph, plain, read_off, turned
from tests.toyhead import sphere_head

HEAD = sphere_head(40, 60)
CHART = Chart.build(HEAD, 288, 192)
POINTS = CHART.interpolate(HEAD.mean).astype(float)
SKIN_MASK = CHART.part == 0


def _texture(photo: Photo, yaw: float) -> Texture:
    return make_texture(photo, fitted(HEAD, turned(yaw)), CHART, read_off(HEAD, turned(yaw), _parts))


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


@pytest.mark.parametrize(("shade", "black"), [((0.02, 0.02, 0.02), True), ((0.6, 0.3, 0.01), False)])
def test_skin_too_dark_for_its_colour_to_be_told_is_completed(shade: tuple[float, ...], black: bool) -> None:
    """For the albedo; in the texture where it is black in all colours, as what light has left is the photo's."""
    dark_half = photograph(HEAD, turned(0), lambda points: np.where(points[:, :1] > 0, shade, 1.0) * SKIN)
    fit, reading = fitted(HEAD, turned(0)), read_off(HEAD, turned(0), _parts)
    known = Unwrappings.of(CHART, [(dark_half, fit, reading)])
    texture = make_texture(dark_half, fit, CHART, reading, known=known)
    place, dark = POINTS[CHART.texels // CHART.width, CHART.texels % CHART.width], known.sights[0].dark
    hidden = (dark > 0.9) & (place[:, 0] > 0.01)
    assert hidden.sum() > 200
    half = np.unravel_index(CHART.texels[hidden], SKIN_MASK.shape)
    assert np.median(texture.legible[half][:, 2]) > 80
    assert bool(np.median(texture.texture[half][:, 2]) > 80) is black


def test_a_black_collar_that_was_read_as_skin_does_not_blacken_the_neck(monkeypatch: pytest.MonkeyPatch) -> None:
    """A black turtleneck below the chin left a black throat in the texture."""
    place, low = POINTS[CHART.texels // CHART.width, CHART.texels % CHART.width], -0.05
    all_face = Zones.of(CHART)
    face = np.where(place[:, 1] < low, 0, all_face.face).astype(np.float32)
    monkeypatch.setattr(Zones, "of", lambda chart: replace(all_face, face=face))
    collared = photograph(HEAD, turned(0), lambda points: np.where(points[:, 1:2] < low, 0.01, 1.0) * SKIN)
    fit, reading = fitted(HEAD, turned(0)), read_off(HEAD, turned(0), _parts)
    known = Unwrappings.of(CHART, [(collared, fit, reading)])
    texture = make_texture(collared, fit, CHART, reading, known=known)
    neck = (known.sights[0].unwrapped.weight > 0.2) & (place[:, 1] < low - 0.004)
    assert neck.sum() > 50
    assert np.median(texture.texture[np.unravel_index(CHART.texels[neck], SKIN_MASK.shape)]) > 80


def test_the_black_below_a_brim_does_not_reach_the_forehead_that_a_hat_hides() -> None:
    """A head was drawn with a black smear from the eyes to the crown, and no hat."""
    hat, brim = 0.035, 0.0
    shaded = photograph(HEAD, turned(0), lambda points: np.where(points[:, 1:2] > brim, 0.1, 1.0) * SKIN)
    reading = read_off(HEAD, turned(0), lambda points: np.where(points[:, 1] > hat, HAT, _parts(points)))
    texture = make_texture(shaded, fitted(HEAD, turned(0)), CHART, reading)
    height, face = POINTS[..., 1], CHART.fill_outside(CHART.spread(Zones.of(CHART).face[:, None])[..., 0]) > 0.5
    hidden = SKIN_MASK & face & (height > hat + 0.01)
    assert hidden.sum() > 50
    for shown in (texture.texture, texture.legible):
        assert np.abs(np.median(shown[hidden], 0) / 255 - SKIN).max() < 0.08


def test_unseen_half_is_the_mirror_image() -> None:
    texture = _texture(photograph(HEAD, turned(50), checks), 50)
    from_mirror = SKIN_MASK & (texture.confidence < SEEN) & (texture.confidence >= SEEN - 10)
    assert from_mirror.sum() > 500
    error = _error(texture, from_mirror, checks(POINTS.reshape(-1, 3)).reshape(POINTS.shape))
    assert np.median(error) < 0.02
    assert np.mean(error > 0.1) < 0.15


def test_background_does_not_reach_the_skin() -> None:
    """A fit that is 5 mm too large all round reads the green wall at its rim, at angles that count."""
    photo = photograph(HEAD, turned(0), plain(SKIN))
    larger = (HEAD.mean * np.float32(1.06)).astype(np.float32)
    texture = make_texture(photo, fitted(HEAD, turned(0), larger), CHART)
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


def _require_sound(texture: Texture) -> None:
    shape = (CHART.height, CHART.width)
    assert texture.texture.shape == (*shape, 3)
    assert texture.texture.dtype == texture.confidence.dtype == np.uint8
    assert texture.shape_normal_object.dtype == np.float32
    assert np.allclose(np.linalg.norm(texture.shape_normal_object, axis=-1), 1, atol=1e-4)
    assert np.array_equal(texture.mask, CHART.mask)
    assert 0 <= texture.visible_fraction <= 1
    assert texture.texture[..., 0].min() > 0  # no black hole anywhere, not even beside the islands


def test_nothing_seen_is_complete_and_says_so() -> None:
    """The head lies outside the photo: default colours, confidence 0 everywhere."""
    camera = turned(0)
    away = replace(camera, principal_point=np.array([-5000.0, -5000.0]))
    texture = make_texture(Photo(np.zeros((400, 400, 3), np.uint8)), fitted(HEAD, away), CHART)
    _require_sound(texture)
    assert not texture.confidence.any()
    assert texture.visible_fraction == 0
    assert texture.warnings == ("little-seen", "not-segmented")


@pytest.mark.parametrize("depth", [-1.0, 0.02])
def test_a_camera_behind_or_within_the_head_gives_finite_maps(depth: float) -> None:
    """Vertices on both sides of the camera project to wild places."""
    camera = replace(turned(0), translation=np.array([0.0, 0.0, depth]))
    texture = make_texture(Photo(np.full((400, 400, 3), 99, np.uint8)), fitted(HEAD, camera), CHART)
    _require_sound(texture)
    assert depth > 0 or texture.visible_fraction == 0


def test_zero_area_triangles_are_harmless() -> None:
    """A quarter of the head collapsed into one point: no normals, no area, no Jacobian there."""
    vertices = HEAD.mean.copy()
    vertices[: len(vertices) // 4] = vertices[0]
    photo = photograph(HEAD, turned(0), checks)
    _require_sound(make_texture(photo, fitted(HEAD, turned(0), vertices), CHART))


def test_face_half_outside_the_photo() -> None:
    camera = replace(turned(0), principal_point=np.array([0.0, 200.0]))
    texture = make_texture(photograph(HEAD, camera, checks), fitted(HEAD, camera), CHART)
    _require_sound(texture)
    seen = (texture.confidence >= SEEN) & SKIN_MASK
    assert POINTS[..., 0][seen].min() > -0.002


def test_grey_photo_gives_grey_maps_also_where_made_up() -> None:
    def paint(points: np.ndarray) -> np.ndarray:
        return np.broadcast_to(checks(points).mean(1, keepdims=True), (len(points), 3))

    texture = _texture(photograph(HEAD, turned(0), paint, (0.4, 0.4, 0.4)), 0).texture.astype(int)
    assert (texture.max(-1) - texture.min(-1)).max() <= 2
