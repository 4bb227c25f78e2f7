"""Real photos' classes weighed with the reader's parts, by networks whose answers are known, and the shipped one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.errors import NumericFault
from service.face.reading.part_labels import BACKGROUND, BEARD, CLOTH, HAIR, HAT, OTHER, PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading, parts_at_pixels, with_segments
from service.face.reading.segments import (
    CLASSES,
    SAYS,
    SIDE,
    TOLD,
    SegmenterNetwork,
    Segments,
    likelihoods,
    parts_of,
    weigh_parts,
)  # fmt: skip
from service.face.region import Region
from service.photo.gate import read_photo

PIXELS = np.zeros((400, 400, 3), np.uint8)
SAMPLE = Path(__file__).parents[4] / "service" / "data" / "sample" / "astronaut.png"
BACK, LOCKS, FACE, CLOTHES, THING = (CLASSES.index(n) for n in ("background", "hair", "face skin", "clothes", "thing"))


def shares(classes: np.ndarray, sure: float = 0.97) -> np.ndarray:
    """Probabilities of indices of classes."""
    rest = (1 - sure) / (len(CLASSES) - 1)
    return np.asarray(np.eye(len(CLASSES))[classes] * (sure - rest) + rest, np.float32)


def segments(classes: np.ndarray, side: float = 250.0) -> Segments:
    """Indices (256, 256) of classes in a square round (200, 200)."""
    return Segments(Region(200, 200, side), shares(classes))


def grid(side: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Photo pixels of cells, from the middle of a square on."""
    at = (np.arange(count) + 0.5 - count / 2) * side / count
    return tuple(np.meshgrid(at, at))  # type: ignore[return-value]


def reading(side: float, around: Reading | None = None) -> Reading:
    """Skin in a disc of 40 pixels, hair beside it with 0.7 on the left, background right."""
    x, y = grid(side, PART_CELLS)
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., BACKGROUND] = 1.0
    parts[x < 0] = np.eye(len(PARTS))[HAIR] * 0.7 + np.eye(len(PARTS))[BACKGROUND] * 0.3
    parts[np.hypot(x, y) < 40] = np.eye(len(PARTS))[SKIN]
    ones, vectors = np.ones((CELLS, CELLS)), np.zeros((CELLS, CELLS, 3))
    return Reading(Region(200, 200, side), vectors[..., :2], ones, vectors, ones, parts, around=around)


def scene() -> np.ndarray:
    """A face, a cap above it, hair round it to 60 pixels, a shirt 100 pixels below, background."""
    x, y = grid(250.0, SIDE)
    classes = np.where(np.hypot(x, y) < 60, LOCKS, BACK)
    classes[y > 100] = CLOTHES
    classes[np.hypot(x, y) < 40] = FACE
    classes[(y < -45) & (np.hypot(x, y) < 70)] = THING
    return np.asarray(classes)


def test_a_curtain_is_no_hair_and_a_cap_no_hair_and_locks_are_hair() -> None:
    """A curtain beside a head was hair: it came out longer; a knitted cap was a crop in the cap's colour."""
    seen = with_segments(PIXELS, reading(150, reading(200)), segments(scene()))
    at = np.array([[150.0, 200.0], [138.0, 200.0], [110.0, 200.0], [190.0, 145.0], [250.0, 200.0], [200.0, 200.0]])
    found = parts_at_pixels(seen, at)
    assert found[0, HAIR] > 0.85, "locks that both see"
    assert (found[1:3, HAIR] < 0.15).all(), "a curtain, in the narrow crop and beyond it"
    assert found[3].argmax() == HAT
    assert found[4, HAIR] > 0.2, "locks that the reader missed"
    assert found[5, SKIN] > 0.95
    assert seen.around is not None
    for one in (seen, seen.around):
        np.testing.assert_allclose(one.parts.sum(-1), 1, atol=1e-5)
        assert (one.parts >= 0).all()


def test_beyond_the_readers_crops_the_segmentation_tells() -> None:
    """Locks below the wider crop counted as background."""
    seen = with_segments(PIXELS, reading(150, reading(200)), segments(scene()))
    found = parts_at_pixels(seen, np.array([[200.0, 312.0], [90.0, 200.0]]))
    assert found[0, CLOTH] > 0.9 and found[1, BACKGROUND] > 0.9
    alone = parts_at_pixels(reading(150, reading(200)), np.array([[200.0, 312.0]]))
    assert alone[0, BACKGROUND] == 1.0


@pytest.mark.parametrize("klass", range(len(CLASSES)))
def test_a_network_that_says_the_same_everywhere_moves_no_part_to_another(klass: int) -> None:
    """Paintings and masks are no person to it: what it says of them must not erase the reader's face."""
    before = reading(150, reading(200))
    after = with_segments(PIXELS, before, segments(np.full((SIDE, SIDE), klass)))
    assert (after.parts.argmax(-1) == before.parts.argmax(-1)).mean() > 0.99


def test_a_beard_that_is_called_face_stays_a_beard() -> None:
    parts = np.full((1, len(PARTS)), 0.01, np.float32)
    parts[0, BEARD] = 1 - 0.01 * (len(PARTS) - 1)
    assert weigh_parts(parts, shares(np.array([FACE])), SAYS)[0].argmax() == BEARD


def test_rows_are_probabilities() -> None:
    for table in (SAYS, TOLD):
        np.testing.assert_allclose(table.sum(1), 1, atol=1e-5)
        assert (table >= 0).all()
    assert (SAYS > 0).all(), "the logarithm of what never happens would be -Inf"
    np.testing.assert_allclose(parts_of(shares(np.arange(6))).sum(1), 1, atol=1e-5)
    assert parts_of(shares(np.array([THING])))[0].argmax() in (HAT, OTHER)


@pytest.mark.parametrize("count", [0, 4])
def test_without_a_face_or_a_background_nothing_is_divided_by_zero(count: int) -> None:
    """No cell lies in the photo, or none shows a face: rates would be 0 / 0."""
    parts = np.zeros((count, len(PARTS)), np.float32)
    parts[:, HAIR] = 1.0
    says = likelihoods(parts, shares(np.zeros(count, int)), np.ones(count, bool))
    assert np.isfinite(says).all() and (says > 0).all()
    told = weigh_parts(np.zeros((2, len(PARTS)), np.float32), np.zeros((2, 6), np.float32), says)
    assert np.isfinite(told).all()


class Faulty:
    """Gives no numbers."""

    def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        raise NumericFault("network segmenter: output classes has 4 of 65536 values that are NaN or Inf")


def test_the_shipped_network_knows_the_samples_hair_face_and_clothes() -> None:
    """Eileen Collins before a flag, in an orange suit."""
    pixels = read_photo(SAMPLE.read_bytes()).pixels
    found = SegmenterNetwork()(pixels, Region(225, 170, 440)).at(
        np.array([[225.0, 120.0], [180.0, 60.0], [120.0, 300.0], [40.0, 60.0]])
    )
    assert found.argmax(1).tolist() == [FACE, LOCKS, CLOTHES, BACK]
    np.testing.assert_allclose(found.sum(1), 1, atol=1e-4)


def test_nothing_is_seen_beyond_the_photo() -> None:
    """In the black round a photo that ends at the chin the network saw another face."""
    pixels = read_photo(SAMPLE.read_bytes()).pixels[60:280, 100:350]
    found = SegmenterNetwork()(pixels, Region(125, 110, 500))
    y, x = np.mgrid[:SIDE, :SIDE]
    beyond = (abs(x + 0.5 - SIDE / 2) > 66) | (abs(y + 0.5 - SIDE / 2) > 58)
    assert (found.shares[beyond].argmax(-1) == BACK).all()
    assert (found.shares[~beyond].argmax(-1) == FACE).mean() > 0.1


def test_the_network_is_fed_as_it_was_taught() -> None:
    """From -1 to 1. From 0 to 1 it seemed to work, but lost dark clothes, and black hats before black walls."""

    class Seen:
        def run(self, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
            self.range = float(inputs["image"].min()), float(inputs["image"].max())
            return [np.zeros((1, SIDE, SIDE, len(CLASSES)), np.float32)]

    pixels, seen = np.zeros((400, 400, 3), np.uint8), Seen()
    pixels[:200] = 255
    SegmenterNetwork(seen)(pixels, Region(200, 200, 300))  # type: ignore[arg-type]
    assert seen.range == (-1.0, 1.0)
    whole = read_photo(SAMPLE.read_bytes()).pixels
    found = SegmenterNetwork()(whole, Region(225, 170, 440)).at(np.array([[225.0, 245.0], [225.0, 330.0]]))
    assert found.argmax(1).tolist() == [CLOTHES, CLOTHES], "the black collar of the suit"
