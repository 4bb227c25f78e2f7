from __future__ import annotations

import numpy as np
import pytest

from service.face.finder import Face, FaceFinder
from service.face.identity import (
    Recogniser,
    alignment,
    centred_cosine,
    distance,
)
from tests.service.face.conftest import Pixels


@pytest.fixture(scope="module")
def recogniser() -> Recogniser:
    return Recogniser()


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
