"""Previews show the head where it is, the right way round, whatever comes in."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import get_args

import cv2
import numpy as np
import pytest

from service.archive.pack import draw
from service.archive.preview.overlay import crop_box, overlay
from service.archive.preview.sheet import TILE, WARNING, blank, coloured, sheet, write_text
from service.colour import bytes_to_linear
from service.geometry.camera import Camera
from service.light.environment import Illumination
from service.render.draw import see
from service.render.drawn import DrawnHead
from service.render.sketch import over, sketch
from service.render.view import turned_camera
from service.words import WORDS, WarningCode
from tests.service.archive.toys import toy_avatar, toy_head

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


def test_a_head_behind_or_beside_the_camera_draws_nothing() -> None:
    for shift in ([0.0, 0.0, -5.0], [50.0, 0.0, 0.0], [0.0, 1e12, 0.0]):
        camera = replace(FRONT, translation=FRONT.translation + shift)
        assert drawn(camera=camera)[1].max() == 0


def test_a_head_that_is_a_single_point() -> None:
    points = np.zeros_like(HEAD.mean)
    camera = turned_camera(points, 30, *TILE)
    assert np.isfinite(camera.focal_px)
    assert see(DrawnHead.of(HEAD, points), camera, 1.0).index.size == 0


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
    assert sheet(avatar, draw(avatar)).std() > 0


def test_sheet_shows_views_facts_and_maps() -> None:
    first = sheet(toy_avatar(), draw(toy_avatar()))
    np.testing.assert_array_equal(first, sheet(toy_avatar(), draw(toy_avatar())))
    many = replace(toy_avatar(), warnings=get_args(WarningCode)[:9])
    assert sheet(many, draw(many)).shape == first.shape
    assert (sheet(many, draw(many)) != first).any(), "warnings are on the sheet"


def test_what_is_made_for_a_photo_without_colour_shows_none_in_its_light() -> None:
    """Teeth and sclera were blue and hair green: their own hue in a light that makes skin grey."""
    plain = toy_avatar()
    ruddy = np.broadcast_to(np.array([190, 130, 110], np.uint8), plain.texture.texture.shape)
    for cheek, hue in ((0.5, 0.5, 0.5), False), ((0.6, 0.5, 0.45), True), (None, True):
        told = None if cheek is None else np.array(cheek, np.float32)
        avatar = replace(
            plain, fit=replace(plain.fit, cheek=told), texture=replace(plain.texture, texture=ruddy.copy())
        )
        middle = np.ptp(coloured(avatar)[0][2][1][110:160, 110:150].astype(int), 2)
        assert (middle > 20).any() == hue, cheek


def test_warnings_on_the_sheet_are_sentences_that_fit() -> None:
    """They were bare codes."""
    longest = sorted(get_args(WarningCode), key=lambda code: len(WORDS["warnings"][code]))[-4:]
    plain = toy_avatar()
    fit, texture = replace(plain.fit, warnings=()), replace(plain.texture, warnings=())
    page = sheet(replace(plain, fit=fit, texture=texture, warnings=tuple(longest)), draw(plain))
    assert (page[:, -22:] == page[0, 0]).all(), "a sentence runs over the margin"
    for code in longest:
        words = blank(520, 20)
        write_text(words, WORDS["warnings"][code], 0, 14, 14, WARNING)
        found = cv2.matchTemplate(page, words[:, :480], cv2.TM_SQDIFF_NORMED)
        assert found.min() < 1e-3, code


def test_text_is_the_same_from_any_thread() -> None:
    def written() -> np.ndarray:
        page = blank(120, 40)
        write_text(page, "45°", 5, 30, 20, bold=True)
        return page

    with ThreadPoolExecutor(4) as pool:
        pages = [one.result() for one in [pool.submit(written) for _ in range(8)]]
    assert len(np.unique(pages[0])) > 8, "nothing is written"
    assert all(np.array_equal(one, pages[0]) for one in pages)
