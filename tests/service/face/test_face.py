
from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from service.errors import FaceCutOff, FaceTooSmall, MultipleFaces, NoFace, UsageError
from service.face.finder import Face, choose_face

PHOTO = (1000, 800)


def face(x: float, y: float, size: float) -> Face:
    box = np.array([x - size / 2, y - size / 2, x + size / 2, y + size / 2])
    random = np.random.default_rng(0)
    landmarks = np.concatenate([random.uniform(box[:2], box[2:], (468, 2)), np.zeros((468, 1))], 1)
    return Face(box, 0.9, np.tile([x, y], (6, 1)), landmarks, 1.0)


def test_one_face_is_taken() -> None:
    only = face(400, 400, 200)
    assert choose_face([only], None, PHOTO) is only


def test_none() -> None:
    with pytest.raises(NoFace, match="no face"):
        choose_face([], "largest", PHOTO)


def test_two_alike_are_refused_with_their_boxes() -> None:
    with pytest.raises(MultipleFaces) as caught:
        choose_face([face(300, 300, 200), face(700, 300, 180)], None, PHOTO)
    assert caught.value.extra["boxes"] == [[200.0, 200.0, 400.0, 400.0], [610.0, 210.0, 790.0, 390.0]]
    json.dumps(caught.value.extra)


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


def test_half_outside_is_cut_off_and_a_rim_is_not() -> None:
    with pytest.raises(FaceCutOff, match="inside the photo"):
        choose_face([face(0, 400, 300)], None, PHOTO)
    assert choose_face([face(120, 400, 300)], None, PHOTO).score == 0.9
