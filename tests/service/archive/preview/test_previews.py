"""Previews show the head where it is, the right way round, whatever comes in."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.archive.preview import sheet as page
from service.archive.preview.overlay import PANEL, crop_box, fitted_landmarks, overlay
from service.archive.preview.sheet import (
    INPAINTED_COLOUR,
    MIRRORED_COLOUR,
    SEEN_COLOUR,
    TEXTURED_YAWS,
    TILE,
    confidence_colours,
    lamps,
    sheet,
    side_lamp,
)
from service.colour import bytes_to_linear, srgb_to_linear
from service.geometry.camera import Camera
from service.light.environment import Illumination
from service.map_registry import MIRRORED, SEEN
from service.render.draw import DrawnHead, over, see, sketch
from service.render.view import turned_camera
from tests.service.archive.toys import toy_avatar, toy_head
from tests.toyhead import CENTRE, RADIUS

HEAD = toy_head()
FRONT = Camera(160, 120, 400.0, np.array([80.0, 60.0]), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.6]))


def drawn(
    texture: np.ndarray | None = None, light: Illumination | None = None, camera: Camera = FRONT
) -> tuple[np.ndarray, np.ndarray]:
    """Coded colours (h, w, 3) over black, and coverage (h, w), of the toy in a texture of its chart."""
    colours = bytes_to_linear(np.full((4, 6, 3), 128, np.uint8) if texture is None else texture)
    seen = see(DrawnHead.of(HEAD, HEAD.mean), camera, 1.5, colours)
    picture = sketch(seen, seen.read(colours), light)
    return over(*picture, np.zeros((1, 1, 3), np.float32)), picture[1]


def test_the_drawn_ball_is_where_the_camera_puts_it() -> None:
    colour, coverage = drawn()
    middle = FRONT.project(CENTRE[None])[0]
    depth = FRONT.to_camera(CENTRE[None])[0, 2]
    radius = FRONT.focal_px * RADIUS / np.sqrt(depth**2 - RADIUS**2)  # outline of a ball in perspective
    y, x = np.mgrid[0:120, 0:160] + 0.5
    away = np.hypot(x - middle[0], y - middle[1])
    np.testing.assert_allclose(coverage[away < radius - 2], 1, atol=1e-6)
    assert (coverage[away > radius + 1] == 0).all()
    assert coverage.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    assert np.isfinite(colour).all() and colour.min() >= 0 and colour.max() <= 1


def test_the_texture_is_the_right_way_round() -> None:
    """Subject's left (u > 0.5) red, right green, the top blue too; from the front, left is on the right."""
    texture = np.zeros((64, 96, 3), np.uint8)
    texture[:, 48:, 0] = 255
    texture[:, :48, 1] = 255
    texture[:26, :, 2] = 255
    colour = drawn(texture)[0]
    assert colour[80, 110, 0] > 0.5 > colour[80, 110, 1], "image right is the subject's left"
    assert colour[80, 50, 1] > 0.5 > colour[80, 50, 0]
    assert colour[25, 110, 2] > 0.5 > colour[95, 110, 2], "up is up"


@pytest.mark.parametrize(("azimuth", "brighter"), [(-70, slice(30, 60)), (70, slice(100, 130))])
def test_albedo_is_lit_from_where_the_lamp_stands(azimuth: int, brighter: slice) -> None:
    row = drawn(np.full((16, 24, 3), 200, np.uint8), side_lamp(FRONT, azimuth))[0][60, :, 1]
    darker = slice(160 - brighter.stop, 160 - brighter.start)
    assert row[brighter].mean() > row[darker].mean() + 0.2


def test_lit_albedo_is_albedo_times_light() -> None:
    albedo = np.full((16, 24, 3), (200, 120, 60), np.uint8)
    found = srgb_to_linear(drawn(albedo, lamps(FRONT, (), (0.5, 0.25, 1.0)))[0][60, 80])
    wanted = srgb_to_linear(albedo[0, 0] / np.float32(255)) * np.array([0.5, 0.25, 1.0])
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    towards = lamps(FRONT, [((0.0, 0.0, -1.0), (0.4, 0.4, 0.4))], (0.0, 0.0, 0.0))
    facing = srgb_to_linear(drawn(albedo, towards)[0][60, 80]) / srgb_to_linear(albedo[0, 0] / np.float32(255))
    np.testing.assert_allclose(facing, 0.4, rtol=0.15)


@pytest.mark.parametrize("yaw", TEXTURED_YAWS)
def test_turned_views_hold_the_whole_head(yaw: int) -> None:
    camera = turned_camera(HEAD.mean, yaw, *TILE)
    pixels = camera.project(HEAD.mean)
    assert (pixels > 0).all() and (pixels < TILE).all()
    assert camera.yaw_pitch_roll_deg()[0] == pytest.approx(yaw, abs=1e-6)
    assert np.linalg.det(camera.rotation) == pytest.approx(1)


def test_a_view_from_the_right_shows_the_right_side() -> None:
    """Captions of the sheet: a head turned to the image right (yaw > 0) shows its own right cheek."""
    camera = turned_camera(HEAD.mean, 90, *TILE)
    right, left = np.array([[-RADIUS, 0, CENTRE[2]]]), np.array([[RADIUS, 0, CENTRE[2]]])
    assert camera.to_camera(right)[0, 2] < camera.to_camera(left)[0, 2]


def test_a_head_behind_or_beside_the_camera_draws_nothing() -> None:
    for shift in ([0.0, 0.0, -5.0], [50.0, 0.0, 0.0], [0.0, 1e12, 0.0]):
        camera = replace(FRONT, translation=FRONT.translation + shift)
        assert drawn(camera=camera)[1].max() == 0


def test_a_head_that_is_a_single_point() -> None:
    points = np.zeros_like(HEAD.mean)
    camera = turned_camera(points, 30, *TILE)
    assert np.isfinite(camera.focal_px)
    assert see(DrawnHead.of(HEAD, points), camera, 1.0).index.size == 0


def test_overlay_has_three_panels_and_fits() -> None:
    picture = overlay(toy_avatar())
    assert picture.dtype == np.uint8 and picture.shape[2] == 3
    assert max(picture.shape) <= 1610 and picture.shape[1] <= 3 * PANEL[0] + 48
    np.testing.assert_array_equal(picture, overlay(toy_avatar()))


def test_overlay_shows_the_head_over_the_head() -> None:
    """A grey photo: the middle panel differs from the first where the head is, and nowhere else."""
    avatar = toy_avatar()
    avatar = replace(avatar, photo=replace(avatar.photo, pixels=np.full((240, 320, 3), 90, np.uint8)))
    picture = overlay(avatar)
    width = (picture.shape[1] - 48) // 3
    first, second = picture[12:-34, 12 : 12 + width], picture[12:-34, 24 + width : 24 + 2 * width]
    drawn = np.abs(second.astype(int) - first).max(2) > 8
    left, top, right, _ = crop_box(avatar)
    scale = width / (right - left)
    points = (avatar.fit.camera.project(avatar.fit.vertices) - (left, top)) * scale
    y, x = np.nonzero(drawn)
    for found, wanted, limit in ((x, points[:, 0], drawn.shape[1]), (y, points[:, 1], drawn.shape[0])):
        assert found.min() == pytest.approx(np.clip(wanted.min(), 0, limit), abs=4)
        assert found.max() == pytest.approx(np.clip(wanted.max(), 0, limit), abs=4)


def test_fitted_landmarks_take_the_outline_of_the_nearest_yaw() -> None:
    avatar = toy_avatar()
    moved = avatar.head.contour_triangle.copy()
    moved[0] = 3  # the table's row for -45 degrees, nearest to the toy's -20 only if it were below -22.5
    head = replace(avatar.head, contour_triangle=moved)
    np.testing.assert_array_equal(fitted_landmarks(head, avatar.fit), fitted_landmarks(avatar.head, avatar.fit))
    moved[1] = 3
    rim = head.contour_landmarks
    changed = fitted_landmarks(replace(head, contour_triangle=moved), avatar.fit)
    assert (changed[rim] == changed[rim][0]).all(), "all sit on triangle 3"


@pytest.mark.parametrize("case", ["outside", "behind", "nan landmarks", "huge landmarks", "tiny face", "runaway focal"])
def test_previews_survive_a_fit_gone_wrong(case: str) -> None:
    avatar = toy_avatar()
    fit, face = avatar.fit, avatar.face
    marks = face.landmarks.copy()
    if case == "outside":
        fit = replace(fit, camera=replace(fit.camera, translation=np.array([30.0, 0, 0.6])))
    elif case == "behind":
        fit = replace(fit, camera=replace(fit.camera, translation=np.array([0.0, 0, -3.0])), inter_ocular_px=0.0)
    elif case == "nan landmarks":
        marks[3:200] = np.nan
    elif case == "huge landmarks":
        marks[:50] = 1e15
    elif case == "tiny face":
        face = replace(face, box=np.array([-40.0, -40.0, -39.5, -39.5]))
        fit = replace(fit, camera=replace(fit.camera, translation=np.array([0.0, 0, 400.0])))
    else:
        fit = replace(fit, camera=replace(fit.camera, focal_px=1e9))
    avatar = replace(avatar, fit=fit, face=replace(face, landmarks=marks))
    left, top, right, bottom = crop_box(avatar)
    assert 0 <= left < right <= 320 and 0 <= top < bottom <= 240
    assert max(overlay(avatar).shape) <= 1610
    assert sheet(avatar).std() > 0


def test_sheet_shows_views_facts_and_maps() -> None:
    first = sheet(toy_avatar())
    np.testing.assert_array_equal(first, sheet(toy_avatar()))
    many = replace(toy_avatar(), warnings=tuple(f"warning-{i}" for i in range(9)))
    assert sheet(many).shape == first.shape
    assert (sheet(many) != first).any(), "warnings are on the sheet"


def test_confidence_colours_tell_seen_mirrored_and_made_up_apart() -> None:
    colours = confidence_colours(np.array([[255, SEEN, SEEN - 1, MIRRORED, 0]], np.uint8))[0]
    assert colours[0].tolist() == list(SEEN_COLOUR)
    assert colours[2].tolist() == list(MIRRORED_COLOUR)
    assert colours[4].tolist() == list(INPAINTED_COLOUR)
    assert colours[1, 1] > colours[1, 2] and colours[3, 2] > colours[3, 0], "unsure, but still green and blue"


@pytest.mark.parametrize("typeface", [True, False])
def test_words_are_written_with_old_and_new_opencv(typeface: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not typeface:
        monkeypatch.delattr(cv2, "FontFace", raising=False)
    elif not hasattr(cv2, "FontFace"):
        pytest.skip("this OpenCV has no typeface: version 5 does")
    paper = page.blank(300, 40)
    page.write_text(paper, "Left side, 45° · fit", 5, 28, 18)
    inked = np.abs(paper.astype(int) - page.PAPER).max(2) > 60
    rows, columns = np.nonzero(inked)
    assert 100 < inked.sum() < 3000
    assert rows.min() > 5 and rows.max() < 38 and columns.min() >= 4 and columns.max() < 260
