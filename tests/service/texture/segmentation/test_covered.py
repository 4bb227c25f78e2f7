"""What the reader says to stand before the head is not seen, whatever its colour."""

import numpy as np
import pytest

from service.face.reading.part_labels import BACKGROUND, CLOTH, GLASSES, HAIR, HAT, OTHER, PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading
from service.face.region import Region
from service.geometry.chart import Chart
from service.head.files import load_head
from service.texture.segmentation import Zones, covered, parts_at
from service.texture.texture import make_texture
from service.texture.unwrap import unwrap
from tests.service.texture.scenes import SKIN as TONE
from tests.service.texture.scenes import fitted, photograph, plain, turned

HEAD = load_head(None)
CHART = Chart.build(HEAD, 288, 192)
CAMERA = turned(0.0)
FIT = fitted(HEAD, CAMERA)


def reading(part: int, left_half: bool = True) -> Reading:
    """All is skin, but one half of the picture (or all of it) shows ``part``."""
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., SKIN] = 1
    where = slice(0, PART_CELLS // 2) if left_half else slice(None)
    parts[:, where] = np.eye(len(PARTS), dtype=np.float32)[part]
    grid = np.ones((CELLS, CELLS))
    return Reading(Region(200, 200, 400), np.zeros((CELLS, CELLS, 2)), grid, np.zeros((CELLS, CELLS, 3)), grid, parts)


@pytest.mark.parametrize("part", [BACKGROUND, GLASSES, HAT, CLOTH, OTHER, HAIR])
def test_the_part_hides_its_half_and_no_more(part: int) -> None:
    """One pixel off, or x and y exchanged, and the border would not lie in the middle of the face."""
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    hidden = covered(parts_at(reading(part), FIT, unwrapped), zones)
    shown = (unwrapped.weight > 0) & (zones.scalp == 0)
    x = CAMERA.project(unwrapped.position)[:, 0]
    assert (hidden[shown & (x < 195)] > 0.99).all() and (hidden[shown & (x > 205)] < 0.01).all()
    assert (hidden[unwrapped.weight == 0] == 0).all()


def test_hair_on_the_scalp_is_the_head_s_own() -> None:
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    hidden = covered(parts_at(reading(HAIR, left_half=False), FIT, unwrapped), zones)
    assert (hidden[zones.scalp > 0.99] == 0).all()
    assert (hidden[(unwrapped.weight > 0) & (zones.scalp == 0)] == 1).all()


def test_a_hand_of_the_colour_of_skin_is_not_kept() -> None:
    """Colours cannot tell it from the face: only the reader does."""

    def half_red(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, :1] < 0, np.array([[0.85, 0.6, 0.5]]), np.array([[*TONE]]))

    photo = photograph(HEAD, CAMERA, half_red)
    without = make_texture(photo, HEAD, FIT, CHART)
    with_it = make_texture(photo, HEAD, FIT, CHART, reading=reading(OTHER))
    # The seen half is mirrored into the other: red goes.
    cheek = np.s_[85:100, 110:125]
    assert with_it.texture[cheek][..., 0].mean() < without.texture[cheek][..., 0].mean() - 5
    assert with_it.visible_fraction < without.visible_fraction


def test_everything_hidden_still_gives_a_head() -> None:
    """No texel is seen: means over nothing must not become NaN."""
    texture = make_texture(photograph(HEAD, CAMERA, plain(TONE)), HEAD, FIT, CHART, reading=reading(HAT, False))
    assert np.isfinite(texture.depth).all() and "little-seen" in texture.warnings


def test_beyond_the_crop_all_is_hidden() -> None:
    """Nothing was read there: a collar below the crop would be skin of the neck."""
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    whole = reading(SKIN)
    half = Reading(Region(200, 100, 200), whole.chart, whole.chart_mm, whole.normal, whole.normal_sine, whole.parts)
    shown, y = unwrapped.weight > 0, CAMERA.project(unwrapped.position)[:, 1]
    hidden = covered(parts_at(half, FIT, unwrapped), zones)
    inside = np.abs(CAMERA.project(unwrapped.position)[:, 0] - 200) < 95
    assert (hidden[shown & inside & (y < 195)] < 0.01).all() and (hidden[shown & (y > 205)] > 0.99).all()
