"""Where the skull ends, by what a reading calls the background, hair and bald skin; and which contour a face shows."""

from dataclasses import replace

import numpy as np
import pytest

from service.arrays import Float64, UInt8
from service.face.finder import Face
from service.face.fit.fit_face import SKULL_SIGMA_M, skull_height
from service.face.fit.landmark_fit import LandmarkModel
from service.face.fit.outline import RIM, OutlineFinder, Softened
from service.face.fit.solver import State, project_points
from service.face.reading.part_labels import BACKGROUND, HAIR, PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading, View
from service.face.region import Region
from service.geometry.camera import exp_rotation
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.photo.photo import Photo

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


PROFILE = State(
    STATE.rotation @ exp_rotation(np.radians([0.0, 85.0, 0.0])), np.zeros(2), STATE.log_scale, STATE.log_distance,
    np.zeros(0),
)  # fmt: skip
MIDDLE = np.array(SIZE) / 2


def white_on_black(head: HeadModel, vertices: Float64) -> UInt8:
    seen = project_points(PROFILE, vertices)
    shown = rasterise(seen.uv + MIDDLE, seen.position[:, 2], head.triangles, *SIZE, perspective=True).mask
    return np.where(shown[..., None], np.uint8(255), np.zeros(3, np.uint8))


def read_off(photo: UInt8) -> Reading:
    """One that calls what is white skin and what is black background."""
    cell = ((np.arange(PART_CELLS) + 0.5) * SIZE[0] / PART_CELLS).astype(int)
    white = photo[np.ix_(cell, cell)][..., 0] > 127
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[white, SKIN], parts[~white, BACKGROUND] = 1.0, 1.0
    return replace(reading(0.0, SKIN), parts=parts)


def test_what_a_profile_hides_is_no_contour(head: HeadModel) -> None:
    """The far eye's lids lie behind the nose, and would be drawn to its edge."""
    finder, vertices = OutlineFinder(head), head.mean.astype(np.float64)
    whole = finder.find(PROFILE, vertices)
    shown, rim = finder.seen(whole, PROFILE, vertices)
    far = head.region("eyelid_left") > 0.5
    assert far[whole.vertices].all(1).sum() > 20
    assert not far[shown.vertices].all(1).any()
    assert rim.sum() > 40
    nose = int(head.mean[:, 2].argmax())
    tip = project_points(PROFILE, vertices[[nose]]).uv
    assert np.linalg.norm(shown.uv[rim] - tip, axis=1).min() < 0.004 * SCALE


def test_the_rim_between_skin_and_background_tells_the_profile(head: HeadModel) -> None:
    """Of several photos: it is drawn to where a longer nose ends, and counts more than where nothing was read."""
    vertices, finder = head.mean.astype(np.float64), OutlineFinder(head)
    tip = vertices[int(head.mean[:, 2].argmax())]
    near = np.exp(-(((vertices - tip) ** 2).sum(1)) / (2 * 0.015**2))[:, None]
    photo = white_on_black(head, vertices + near * np.array([0.0, 0.0, 0.003]))
    soft = Softened.around(photo, MIDDLE, PROFILE, vertices)
    face = Face(np.zeros(4), 0.9, np.zeros((6, 2)), np.zeros((468, 3)), 1.0)
    unread, told = (
        finder.term(soft, MIDDLE, PROFILE, vertices, 0.008, View(Photo(photo), face, read))
        for read in (None, read_off(photo))
    )
    assert unread is not None and told is not None
    _, rim = finder.seen(finder.find(PROFILE, vertices), PROFILE, vertices)
    assert np.allclose(told.precision[~rim], unread.precision[~rim])
    assert np.median(told.precision[rim] / np.maximum(unread.precision[rim], 1e-12)) == pytest.approx(RIM, rel=0.05)
    at_tip = rim & (np.linalg.norm(told.mean - tip, axis=1) < 0.006)
    assert at_tip.any()
    shift = -told.residual(replace(PROFILE, coefficients=np.zeros(told.modes.shape[-1])))[at_tip, 0]
    assert np.median(shift) / SCALE == pytest.approx(0.0029, abs=0.0009)
