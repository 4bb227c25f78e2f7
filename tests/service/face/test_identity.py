from __future__ import annotations

import numpy as np
import pytest

from service.face.finder import Face, FaceFinder
from service.face.identity import (
    PADDING,
    TEMPLATE,
    TEMPLATE_LANDMARKS,
    Recogniser,
    alignment,
    centred_cosine,
    distance,
)
from tests.service.face.conftest import Pixels


@pytest.fixture(scope="module")
def recogniser() -> Recogniser:
    return Recogniser()


def test_alignment_finds_a_known_transform() -> None:
    """Landmarks that are the template, scaled, turned and moved, must land on the template again."""
    landmarks = np.zeros((468, 3))
    angle, scale = 0.7, 83.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    landmarks[list(TEMPLATE_LANDMARKS), :2] = TEMPLATE @ turn.T * scale + [200, -40]
    crop = alignment(landmarks).to_crop(landmarks[list(TEMPLATE_LANDMARKS), :2], 150)
    assert crop == pytest.approx((TEMPLATE + PADDING) / (1 + 2 * PADDING) * 150, abs=1e-6)


@pytest.mark.parametrize("value", [0.0, 7.0, np.nan])
def test_alignment_of_coinciding_landmarks_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="coincide"):
        alignment(np.full((468, 3), value))


def test_the_same_person_altered_is_near(
    recogniser: Recogniser, finder: FaceFinder, portrait: Pixels, face: Face
) -> None:
    one = recogniser.embed(portrait, face.landmarks)
    assert one.shape == (128,)
    dark = (portrait * 0.4).astype(np.uint8)
    grey = np.repeat(portrait.mean(2, keepdims=True).astype(np.uint8), 3, 2)
    mirrored = np.ascontiguousarray(portrait[:, ::-1])
    for other in (dark, grey, mirrored):
        two = recogniser.embed(other, finder.find(other)[0].landmarks)
        assert distance(one, two) < 0.35
        assert centred_cosine(one, two) > 0.8


def test_cosine_by_hand_and_of_the_mean_itself() -> None:
    mean = np.zeros(128)
    a, b = np.eye(128)[0], np.eye(128)[1]
    assert centred_cosine(a, b, mean) == 0.0
    assert centred_cosine(a, a * 3, mean) == 1.0
    assert centred_cosine(a, -a, mean) == -1.0
    assert centred_cosine(mean, a, mean) == 0.0  # no direction: not a division by zero
