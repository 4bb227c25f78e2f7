"""Edges of lids and lips, and scores of the expression, by networks whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.features.rims import RIMS
from service.face.reading.openings import (
    EYE,
    KINDS,
    MOUTH,
    NAMES,
    POINTS,
    SCORED_SIDE,
    STATIONS,
    SUBSET,
    UNSURE,
    Landmarker,
    Opening,
    OpeningsNetwork,
    with_openings,
)
from tests.service.face.geometry import oval


class Known:
    """Says that the upper edge stands ``upper`` above the line of the corners and the lower one ``lower``."""

    outputs = ("heights", "scatter")

    def __init__(self, upper: np.ndarray | float, lower: float, scatter: float = 0.01) -> None:
        self.answer = np.stack([np.broadcast_to(upper, 9), np.full(9, lower)])[None].astype(np.float32)
        self.scatter = np.full((1, 2, 9), scatter, np.float32)

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        patch = inputs["patch"]
        assert patch.shape[:2] == (1, 3) and patch.min() >= 0 and patch.max() <= 1
        return [self.answer, self.scatter]


class Silent(Known):
    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        raise NumericFault("lids: NaN")


def face(angle: float = 0.0) -> np.ndarray:
    """Landmarks that lie on one spot but for the corners of eyes (60 pixels long) and mouth (100)."""
    points = np.zeros((468, 3))
    for kind in KINDS:
        for k, pair in enumerate(kind.corners.values()):
            half, place = (30, (100.0 + 120 * k, 100.0)) if kind is EYE else (50, (160.0, 200.0))
            points[list(pair), :2] = [place[0] - half, place[1]], [place[0] + half, place[1]]
    cos, sin = np.cos(angle), np.sin(angle)
    points[:, :2] = (points[:, :2] - 160) @ np.array([[cos, sin], [-sin, cos]]) + 160
    return points


PHOTO = np.full((320, 320, 3), 128, np.uint8)


def network(*known: Known) -> OpeningsNetwork:
    return OpeningsNetwork(dict(zip((kind.name for kind in KINDS), known, strict=True)))  # type: ignore[arg-type]


def test_outer_corners_stay_outer_on_both_sides() -> None:
    """The left eye is read mirrored: what the network says of the outer corner must not land on the inner one."""
    rising = Known(np.linspace(0.0, 0.2, 9), 0.0)
    found = network(rising, Known(0.1, 0.0))(PHOTO, face())
    assert found["right"].upper[0, 1] > found["right"].upper[-1, 1]
    assert found["left"].upper[0, 1] < found["left"].upper[-1, 1]


def test_an_opening_is_never_less_than_shut() -> None:
    """A network may put the lower edge above the upper one; the lids would turn inside out."""
    found = network(Known(-0.1, 0.1), Known(0.0, 0.0))(PHOTO, face())
    assert np.allclose(found["right"].upper, found["right"].lower)


def test_what_is_unsure_or_no_number_is_left_out() -> None:
    unsure = network(Known(0.2, 0.0, 2 * UNSURE), Known(0.1, 0.0))(PHOTO, face())
    assert set(unsure) == {"mouth"}
    assert network(Silent(0.0, 0.0), Known(0.1, 0.0))(PHOTO, face()) == {}


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_corners_that_coincide_or_are_no_numbers_give_nothing(value: float) -> None:
    """The height is over the distance of the corners: at none, every edge would be at infinity."""
    points = face()
    points[list(MOUTH.corners["mouth"])] = 5.0
    points[EYE.corners["left"][0]] = value
    assert set(network(Known(0.2, 0.0), Known(0.1, 0.0))(PHOTO, points)) == {"right"}


def test_rims_are_brought_onto_the_edges() -> None:
    points = face()
    corners = points[list(EYE.corners["right"]), :2]
    x = corners[0, 0] + 60 * STATIONS
    shut = Opening(np.stack([x, np.full(9, 103.0)], 1), np.stack([x, np.full(9, 103.0)], 1), corners, np.zeros((2, 9)))
    for k, index in enumerate(RIMS["right"]):
        if index not in EYE.corners["right"]:
            points[index] = corners[0, 0] + 10 + 2 * k, 80.0, 7.0
    moved = with_openings(points, {"right": shut})
    rim = [index for index in RIMS["right"] if index not in EYE.corners["right"]]
    inner = (points[rim, 0] > x[0]) & (points[rim, 0] < x[-1])
    assert inner.any() and np.allclose(moved[rim, 1][inner], 103.0)
    assert np.array_equal(moved[:, 2], points[:, 2])
    assert np.array_equal(moved[list(RIMS["mouth"])], points[list(RIMS["mouth"])])


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


@pytest.mark.parametrize("landmarks", [np.full((468, 3), np.nan), np.zeros((468, 3))])
def test_landmarks_without_extent_give_no_scores(landmarks: np.ndarray) -> None:
    assert Landmarker((Points(), Rising()))(np.zeros((9, 9, 3), np.uint8), landmarks) is None  # type: ignore[arg-type]


def test_no_numbers_are_no_scores() -> None:
    """A NaN that went into the prior would end the fit."""
    assert Landmarker((Points(), Broken()))(np.zeros((400, 600, 3), np.uint8), oval(0.0)) is None  # type: ignore[arg-type]
