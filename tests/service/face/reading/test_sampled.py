"""Parts at pixels: the narrow crop where it reaches, the wider one around it, hair where either shows it."""

from __future__ import annotations

import numpy as np

from service.face.reading.parts import BACKGROUND, HAIR, PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading
from service.face.reading.sampled import parts_at_pixels
from service.face.region import Region


def reading(side: float, hair: float, around: Reading | None = None) -> Reading:
    """A crop around (200, 200) that shows skin, and hair with some probability."""
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., HAIR], parts[..., SKIN] = hair, 1 - hair
    grid = np.ones((CELLS, CELLS))
    vectors = np.zeros((CELLS, CELLS, 3))
    return Reading(Region(200, 200, side), vectors[..., :2], grid, vectors, grid, parts, around=around)


def test_hair_beyond_the_narrow_crop_is_read_in_the_wider_one() -> None:
    both = reading(100, 0.0, reading(200, 1.0))
    at = np.array([[200.0, 120.0], [200.0, 20.0]])
    found = parts_at_pixels(both, at)
    assert found[0, HAIR] > 0.99, "above the narrow crop"
    assert found[1, BACKGROUND] == 1.0, "above both"
    assert parts_at_pixels(reading(100, 0.0), at)[0, BACKGROUND] == 1.0


def test_hair_is_where_either_crop_shows_it_and_probabilities_stay_such() -> None:
    at = np.array([[200.0, 200.0], [152.0, 200.0]])
    for narrow, wide in ((0.1, 0.4), (0.4, 0.1), (0.0, 0.0), (1.0, 0.2), (0.0, 1.0)):
        found = parts_at_pixels(reading(100, narrow, reading(200, wide)), at, strands=True)
        np.testing.assert_allclose(found.sum(1), 1, atol=1e-5)
        assert found[0, HAIR] == np.float32(max(narrow, wide))
        assert (found >= 0).all()
        plain = parts_at_pixels(reading(100, narrow, reading(200, wide)), at)
        assert plain[0, HAIR] == np.float32(narrow), "the outline of the hair is that of the finer crop"


def test_more_points_than_opencv_takes_at_a_time() -> None:
    at = np.full((70_000, 2), 200.0)
    assert (parts_at_pixels(reading(100, 0.3), at)[:, HAIR] == np.float32(0.3)).all()
    assert parts_at_pixels(reading(100, 0.3), at[:0]).shape == (0, len(PARTS))
