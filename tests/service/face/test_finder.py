"""Faces of a photo, and the choice of one."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from service.errors import FaceCutOff, FaceTooSmall, MultipleFaces, NoFace, UsageError
from service.face.finder import OVAL, Face, FaceFinder, choose_face
from tests.service.face.conftest import Pixels
from tests.service.face.geometry import inter_ocular, rms

PHOTO = (1000, 800)


def face(x: float, y: float, size: float) -> Face:
    box = np.array([x - size / 2, y - size / 2, x + size / 2, y + size / 2])
    random = np.random.default_rng(0)
    landmarks = np.concatenate([random.uniform(box[:2], box[2:], (468, 2)), np.zeros((468, 1))], 1)
    return Face(box, 0.9, np.tile([x, y], (6, 1)), landmarks, 1.0)


def test_people_in_the_background_do_not_count() -> None:
    portrait = face(300, 300, 400)
    assert choose_face([portrait, face(800, 200, 150)], None, PHOTO) is portrait  # area ratio 1 : 7.1
    with pytest.raises(MultipleFaces):
        choose_face([portrait, face(800, 200, 170)], None, PHOTO)  # 1 : 5.5


def test_a_choice_is_followed() -> None:
    faces = [face(300, 300, 200), face(700, 300, 180)]
    assert choose_face(faces, "largest", PHOTO) is faces[0]
    assert choose_face(faces, 1, PHOTO) is faces[1]


@pytest.mark.parametrize("which", [2, -1, True, 0.5, "second"])
def test_a_face_that_does_not_exist(which: Any) -> None:
    with pytest.raises(UsageError, match="the photo has 2"):
        choose_face([face(300, 300, 200), face(700, 300, 180)], which, PHOTO)


def test_thirty_pixels_are_too_few_and_forty_are_enough() -> None:
    with pytest.raises(FaceTooSmall, match="30 pixels"):
        choose_face([face(300, 300, 30)], None, PHOTO)
    assert choose_face([face(300, 300, 40)], None, PHOTO).area == 1600


def shrunk(picture: Pixels, factor: float) -> Pixels:
    return np.asarray(cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8)


def busy(height: int, width: int, seed: int = 0) -> Pixels:
    """Coloured blocks of many sizes, on which weak detectors fire."""
    random = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for cells in (4, 16, 64):
        blocks = random.uniform(0, 85, (cells, cells, 3)).astype(np.float32)
        total += cv2.resize(blocks, (width, height), interpolation=cv2.INTER_NEAREST)
    return total.astype(np.uint8)


def test_the_sample_face(face: Face) -> None:
    assert face.score > 0.8
    assert face.presence > 0.99
    assert face.warnings == ()
    left, right, nose, mouth = face.keypoints[:4]
    assert left[0] < nose[0] < right[0]
    assert left[1] < nose[1] < mouth[1]
    assert np.linalg.norm(face.landmarks[[1, 4], :2].mean(0) - nose) < 0.15 * inter_ocular(face.landmarks)
    assert face.landmarks[4, 2] < face.landmarks[[234, 454], 2].min()  # the nose is nearer than the ears


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_photo_has_the_turned_landmarks(
    finder: FaceFinder, portrait: Pixels, face: Face, quarters: int
) -> None:
    """The detector takes a face that stands on its head for upright; the mesh has to find out."""
    (turned,) = finder.find(np.ascontiguousarray(np.rot90(portrait, -quarters)))  # clockwise
    x, y = turned.landmarks[:, 0], turned.landmarks[:, 1]
    side = float(portrait.shape[0])
    back = {1: (y, side - x), 2: (side - x, side - y), 3: (side - y, x)}[quarters]
    assert rms(np.stack(back, 1), face.landmarks) < 0.02
    assert turned.warnings == (f"turned-{quarters * 90}",)


def test_a_small_face_in_a_large_busy_picture(finder: FaceFinder, portrait: Pixels, face: Face) -> None:
    """One face of 45 pixels in 1800 x 1400: in the whole picture, seen at 256 pixels, it has 6."""
    scene = busy(1400, 1800)
    inset = shrunk(portrait, 45 / float(face.box[2] - face.box[0]))
    scene[900 : 900 + inset.shape[0], 1300 : 1300 + inset.shape[1]] = inset
    found = [f for f in finder.find(scene) if f.box[0] > 1300 and f.box[1] > 900]
    assert len(found) == 1
    assert "low-resolution" in found[0].warnings


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_face_half_outside_is_no_usable_face(finder: FaceFinder, portrait: Pixels, face: Face, side: str) -> None:
    """The networks make up the missing half, so the answer has to come from where the landmarks lie."""
    x, y = (int(v) for v in (face.box[:2] + face.box[2:]) / 2)
    cut = {
        "left": portrait[:, x:],
        "right": portrait[:, :x],
        "top": portrait[y:],
        "bottom": portrait[:y],
    }[side]
    with pytest.raises((FaceCutOff, NoFace)):
        choose_face(finder.find(np.ascontiguousarray(cut)), None, (cut.shape[1], cut.shape[0]))


@pytest.mark.parametrize(("share", "warned"), [(0.0, False), (0.08, True), (0.15, True)])
@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_face_that_the_edge_cuts(
    finder: FaceFinder, portrait: Pixels, face: Face, side: str, share: float, warned: bool
) -> None:
    """A photo may end where the face does; a chin, forehead or cheek that is missing is told."""
    outline = face.landmarks[list(OVAL), :2]
    (left, top), (right, bottom) = outline.min(0), outline.max(0)
    gone = share * (bottom - top)
    cut = {
        "left": portrait[:, int(left + gone) :],
        "right": portrait[:, : int(np.ceil(right - gone))],
        "top": portrait[int(top + gone) :],
        "bottom": portrait[: int(np.ceil(bottom - gone))],
    }[side]
    found = finder.find(np.ascontiguousarray(cut))
    assert ("face-at-edge" in found[0].warnings) == warned
    assert choose_face(found, None, (cut.shape[1], cut.shape[0])) is found[0], "it is a usable face"


def test_noise_has_no_face(finder: FaceFinder) -> None:
    random = np.random.default_rng(0)
    assert finder.find(random.integers(0, 256, (400, 300, 3)).astype(np.uint8)) == []
    assert finder.find(busy(400, 500)) == []


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 300, 3), (2, 2, 3)])
def test_degenerate_sizes_do_not_break(finder: FaceFinder, shape: tuple[int, int, int]) -> None:
    assert finder.find(np.full(shape, 90, np.uint8)) == []


def test_half_outside_is_cut_off_and_a_rim_is_not() -> None:
    with pytest.raises(FaceCutOff, match="inside the photo"):
        choose_face([face(0, 400, 300)], None, PHOTO)
    assert choose_face([face(120, 400, 300)], None, PHOTO).score == 0.9


@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_flat_picture_has_no_face(finder: FaceFinder, level: int) -> None:
    assert finder.find(np.full((300, 400, 3), level, np.uint8)) == []
