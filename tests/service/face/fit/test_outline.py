"""Where the skull ends: by what a reading calls the background, hair and bald skin."""

import numpy as np
import pytest

from service.arrays import Float64
from service.face.fit.fit_face import SKULL_SIGMA_M, skull_height
from service.face.fit.landmark_fit import LandmarkModel
from service.face.fit.outline import OutlineFinder
from service.face.fit.solver import State
from service.face.reading.part_labels import BACKGROUND, HAIR, PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading
from service.face.region import Region
from service.head.model import HeadModel

SIZE, SCALE = (600, 600), 1800.0
STATE = State(np.diag([1.0, -1.0, -1.0]), np.zeros(2), float(np.log(SCALE)), float(np.log(3.0)), np.zeros(0))


def reading(top: float, shown: int, begins: float = 0.0) -> Reading:
    """One that calls all below a row ``begins`` of the photo ``shown``, but what is higher than ``top``: background."""
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    side = SIZE[1] - begins
    above = begins + (np.arange(PART_CELLS) + 0.5) * side / PART_CELLS < top
    parts[above, :, BACKGROUND], parts[~above, :, shown] = 1.0, 1.0
    grid, vectors = np.full((CELLS, CELLS), 0.4), np.tile([0.0, 0.0, -1.0], (CELLS, CELLS, 1))
    return Reading(Region(SIZE[0] / 2, begins + side / 2, side), vectors[..., :2], grid, vectors, grid, parts)


@pytest.fixture(scope="module")
def skull(head: HeadModel) -> OutlineFinder:
    return OutlineFinder(head, "scalp")


def top_of(skull: OutlineFinder, vertices: Float64) -> float:
    return float(skull.find(STATE, vertices).uv[:, 1].min() + SIZE[1] / 2)


@pytest.mark.parametrize(("shown", "lower", "drawn"), [(HAIR, 30, True), (HAIR, -30, False), (SKIN, -30, True)])
def test_a_skull_ends_in_hair_or_at_bald_skin(
    head: HeadModel, skull: OutlineFinder, shown: int, lower: float, drawn: bool
) -> None:
    """Its top is drawn down out of the background, up to the end of bald skin, and not up into hair."""
    vertices = head.mean.astype(np.float64)
    top = top_of(skull, vertices)
    term = skull.crown_term(reading(top + lower, shown), SIZE, STATE, vertices)
    assert (term is not None) == drawn
    if term is not None:
        middle = np.abs(term.target[:, 0]) < 20
        assert middle.any()
        assert np.allclose(term.target[middle, 1] + SIZE[1] / 2, top + lower, atol=SIZE[1] / PART_CELLS)
        assert np.isfinite(term.target).all() and (term.precision > 0).all()


def test_what_the_photo_does_not_show_tells_no_end(head: HeadModel, skull: OutlineFinder) -> None:
    """What lies beyond the photo, or beyond what was read of it, counts as background elsewhere."""
    vertices = head.mean.astype(np.float64)
    assert skull.crown_term(reading(0.0, HAIR, top_of(skull, vertices) + 20), SIZE, STATE, vertices) is None
    above = STATE.stepped(np.r_[np.zeros(4), -(top_of(skull, vertices) + 20) / SCALE, np.zeros(2)])
    assert skull.crown_term(reading(0.0, HAIR), SIZE, above, vertices) is None


def test_crowns_are_as_high_as_peoples(head: HeadModel) -> None:
    """The coefficients' own prior allows pointed skulls; a face seen from the front would be given one by its brow."""
    row = skull_height(head, LandmarkModel(head, len(head.identity))).row
    alone = float(np.linalg.norm(row)) * SKULL_SIGMA_M
    both = alone / np.sqrt(1 + float(row @ row))
    assert alone > 0.011
    assert 0.005 < both < SKULL_SIGMA_M
