"""Expression scores: the crop, the points in the photo, and what happens without numbers."""

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.detection import face_square
from service.face.reading.openings import NAMES, POINTS, SCORED_SIDE, SUBSET, Landmarker
from tests.service.face.geometry import oval


class Points:
    """Finds all points in the middle of the crop."""

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        assert inputs["image"].shape == (1, SCORED_SIDE, SCORED_SIDE, 3)
        return [np.tile([SCORED_SIDE / 2, SCORED_SIDE / 2, 0.0], POINTS).astype(np.float32), np.zeros(1, np.float32)]


class Rising:
    """Scores that grow with their index, a little beyond both ends of [0, 1]."""

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        assert inputs["points"].shape == (1, len(SUBSET), 2)
        return [np.linspace(-0.1, 1.1, len(NAMES)).astype(np.float32)]


class Broken:
    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        raise NumericFault("face_blendshapes: NaN")


def test_scores_have_names_and_stay_within_bounds() -> None:
    scores = Landmarker((Points(), Rising()))(np.zeros((400, 600, 3), np.uint8), oval(0.3))  # type: ignore[arg-type]
    assert scores is not None
    assert list(scores.units) == list(NAMES[1:])
    assert min(scores.units.values()) == 0.0 and max(scores.units.values()) == 1.0
    assert np.allclose(scores.points, [300.0, 200.0], atol=1.0)


def test_the_crop_holds_the_face_at_mediapipes_size() -> None:
    region = face_square(oval(0.5))
    assert region.side == pytest.approx(1.5 * 140, rel=0.01) and region.angle == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("landmarks", [np.full((468, 3), np.nan), np.zeros((468, 3))])
def test_landmarks_without_extent_give_no_scores(landmarks: np.ndarray) -> None:
    assert Landmarker((Points(), Rising()))(np.zeros((9, 9, 3), np.uint8), landmarks) is None  # type: ignore[arg-type]


def test_no_numbers_are_no_scores() -> None:
    """A NaN that went into the prior would end the fit."""
    assert Landmarker((Points(), Broken()))(np.zeros((400, 600, 3), np.uint8), oval(0.0)) is None  # type: ignore[arg-type]
