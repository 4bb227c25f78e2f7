"""The person told from the background, with a network whose answer is known."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.reading.part_labels import BACKGROUND, HAIR, PARTS, SKIN
from service.face.reading.reader import (
    CELLS,
    PART_CELLS,
    PERSON_SIDE,
    PersonNetwork,
    Reading,
    parts_at_pixels,
    with_person,
)
from service.face.region import Region

PIXELS = np.zeros((400, 400, 3), np.uint8)


class Mask:
    """Sees a person where it is told to, in the crop."""

    def __init__(self, person: np.ndarray) -> None:
        self.person, self.seen = person, []  # type: np.ndarray, list[np.ndarray]

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        self.seen.append(inputs["image"])
        return [self.person.astype(np.float32).reshape(1, PERSON_SIDE, PERSON_SIDE, 1)]


class Faulty:
    """Gives no numbers."""

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        raise NumericFault("network person: output person has 4 of 65536 values that are NaN or Inf")


def network(person: np.ndarray) -> PersonNetwork:
    return PersonNetwork(Mask(person))  # type: ignore[arg-type]


def reading(side: float, around: Reading | None = None) -> Reading:
    """A crop around (200, 200): skin in a disc of 40 pixels, hair beside it with 0.7 on the left, background right."""
    at = (np.arange(PART_CELLS) + 0.5 - PART_CELLS / 2) * side / PART_CELLS
    x, y = np.meshgrid(at, at)
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., BACKGROUND] = 1.0
    parts[x < 0] = np.eye(len(PARTS))[HAIR] * 0.7 + np.eye(len(PARTS))[BACKGROUND] * 0.3
    parts[np.hypot(x, y) < 40] = np.eye(len(PARTS))[SKIN]
    grid, vectors = np.ones((CELLS, CELLS)), np.zeros((CELLS, CELLS, 3))
    return Reading(Region(200, 200, side), vectors[..., :2], grid, vectors, grid, parts, around=around)


def disc(radius: float, side: float = 200.0) -> np.ndarray:
    """A person round the middle of a crop, radius in photo pixels."""
    at = (np.arange(PERSON_SIDE) + 0.5 - PERSON_SIDE / 2) * side / PERSON_SIDE
    return np.hypot(*np.meshgrid(at, at)) < radius


def test_what_is_surely_background_is_no_hair_in_either_crop() -> None:
    """A curtain beside a head was hair: it came out longer, and in the curtain's colour."""
    seen = with_person(PIXELS, reading(150, reading(200)), network(disc(60)))
    at = np.array([[150.0, 200.0], [138.0, 200.0], [110.0, 200.0], [200.0, 200.0]])
    hair = parts_at_pixels(seen, at)[:, HAIR]
    assert hair[0] == pytest.approx(0.7, abs=0.01), "on the person"
    assert (hair[1:3] < 0.1).all(), "beside the person, in the narrow crop and beyond it"
    assert parts_at_pixels(seen, at)[3, SKIN] > 0.99
    assert seen.around is not None
    for one in (seen, seen.around):
        np.testing.assert_allclose(one.parts.sum(-1), 1, atol=1e-5)
        assert (one.parts >= 0).all()


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_a_network_that_sees_the_same_everywhere_changes_nothing(value: float) -> None:
    """It took away whole people to whom it is blind, the parts times its mask: paintings, black masks."""
    before = reading(150, reading(200))
    after = with_person(PIXELS, before, network(np.full((PERSON_SIDE, PERSON_SIDE), value)))
    assert after.around is not None and before.around is not None
    np.testing.assert_allclose(after.parts, before.parts, atol=1e-6)
    np.testing.assert_allclose(after.around.parts, before.around.parts, atol=1e-6)


def test_without_numbers_the_reading_stays_and_the_log_says_so(caplog: pytest.LogCaptureFixture) -> None:
    before = reading(150, reading(200))
    with caplog.at_level(logging.WARNING):
        assert with_person(PIXELS, before, PersonNetwork(Faulty())) is before  # type: ignore[arg-type]
    assert "not told from the background" in caplog.text and "NaN" in caplog.text
