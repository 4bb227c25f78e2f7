from __future__ import annotations

import numpy as np
import pytest

from service.geometry.chart import Chart
from service.reflectance.relief.displacement import REACH_MM, Seams, Steps, join
from tests.toyhead import SKIN_U, sphere_head

SIZE = (384, 256)


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart.build(sphere_head(), *SIZE)


def test_the_pairs_of_the_sphere_lie_at_both_ends_of_a_row(chart: Chart) -> None:
    """The toy's skin is cut at the back, where u = SKIN_U[0] and u = SKIN_U[1] meet at the same latitude."""
    seams = Seams.of(chart.head, 0, chart.part == 0)
    rows, columns = np.stack([seams.one, seams.other]) // SIZE[0], np.stack([seams.one, seams.other]) % SIZE[0]
    middle = (rows[0] > 20) & (rows[0] < 160)  # away from the poles, where neighbouring triangles are cut too
    assert middle.sum() > 130
    assert (np.abs(rows[0] - rows[1]) <= 1)[middle].all()
    left, right = columns.min(0)[middle], columns.max(0)[middle]
    assert np.abs(left - SKIN_U[0] * SIZE[0]).max() < 3 and np.abs(right - SKIN_U[1] * SIZE[0]).max() < 3
    position = chart.interpolate(chart.head.mean).reshape(-1, 3)
    assert np.linalg.norm(position[seams.one] - position[seams.other], axis=1).max() < 0.006, "two texels of 2.9 mm"


def test_sides_meet_and_nothing_changes_further_away(chart: Chart) -> None:
    """A slope over the chart of 2 mm: at the cut it would be a wall of 2 mm."""
    mask = chart.part == 0
    seams = Seams.of(chart.head, 0, mask)
    wall = np.where(mask, np.linspace(-1, 1, SIZE[0], dtype=np.float32), 0).astype(np.float32)
    assert np.abs(wall.ravel()[seams.one] - wall.ravel()[seams.other]).max() > 1.8
    fine = Steps.of(chart, chart.head.mean).texel_mm() * np.float32(0.1)  # a head so small that texels are fine
    joined = join(wall, seams, mask, fine)
    step = np.abs(joined.ravel()[seams.one] - joined.ravel()[seams.other])
    row = seams.one // SIZE[0]
    assert step[(row > 20) & (row < 160)].max() < 0.010
    columns = np.arange(SIZE[0])
    far = (columns > SKIN_U[0] * SIZE[0] + 2 * REACH_MM / fine.min()) & (columns < SIZE[0] / 2)
    np.testing.assert_array_equal(joined[70:110, far], wall[70:110, far])
    assert not np.isnan(joined).any()
    assert (joined[~mask] == wall[~mask]).all()


def test_heights_that_meet_already_stay(chart: Chart) -> None:
    flat = np.full(SIZE[::-1], 0.3, np.float32)
    mask = chart.part == 0
    steps = Steps.of(chart, chart.head.mean)
    np.testing.assert_array_equal(join(flat, Seams.of(chart.head, 0, mask), mask, steps.texel_mm()), flat)


def test_a_part_without_cuts_and_an_empty_mask(chart: Chart) -> None:
    teeth = chart.head.part_names.index("teeth_upper")
    seams = Seams.of(chart.head, teeth, chart.part == teeth)
    assert len(seams.one) == 0
    flat = np.zeros(SIZE[::-1], np.float32)
    assert join(flat, seams, chart.mask, np.ones((2, 3), np.float32)) is flat
    assert len(Seams.of(chart.head, 0, np.zeros(SIZE[::-1], bool)).one) == 0
