"""What the photo does not show."""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.texture.inpainting import complete_skin, grain
from tests.toyhead import sphere_head

CHART = Chart.build(load_head(None), 576, 384)
GRAIN = grain(CHART, 0)
MAP = CHART.spread(GRAIN)[..., 0]
POSITION = CHART.interpolate(CHART.head.mean).astype(float)
SKIN = CHART.part == 0


def _slopes(name: str) -> tuple[float, float]:
    """Root mean square of the grain's change per metre along rows and down columns, in a region."""
    region = CHART.interpolate(CHART.head.region(name))[..., 0] > 0.9
    result = []
    for axis in (1, 0):
        step = np.linalg.norm(np.diff(POSITION, axis=axis), axis=2)
        inside = (region & SKIN).take(range(step.shape[axis]), axis) & (step > 1e-4) & (step < 6e-3)
        result.append(float(np.sqrt(np.mean((np.diff(MAP, axis=axis)[inside] / step[inside]) ** 2))))
    return result[0], result[1]


def test_grain_is_no_streak_where_the_chart_is_stretched() -> None:
    """Noise of the chart's own texels was drawn out sixfold on the neck and looked like fur."""
    for name, bound in (("cheek_left", 1.25), ("neck", 1.6)):
        across, down = _slopes(name)
        assert 1 / bound < across / down < bound, f"{name}: {across:.0f} and {down:.0f} per metre"


def test_tiny_charts_have_finite_grain() -> None:
    """A texel of several centimetres is beyond the coarsest octave."""
    assert np.isfinite(grain(Chart.build(CHART.head, 24, 16), 0)).all()


HEAD = load_head()
LIPS_CHART = Chart.build(HEAD, 384, 256)
PLAIN, RED = np.array([0.75, 0.59, 0.51], np.float32), np.array([0.70, 0.35, 0.36], np.float32)
LIPS = LIPS_CHART.inside(vertex_mask(HEAD, "lips")[:, None])[:, 0]
INSIDE = LIPS_CHART.inside(vertex_mask(HEAD, "mouth_inner")[:, None])[:, 0]
ROWS = LIPS_CHART.texels // LIPS_CHART.width


def completed(seen_lips: np.ndarray) -> np.ndarray:
    """Colours (N, 3) when all skin is seen but lips only where told."""
    colour = np.where((LIPS > 0.6)[:, None], RED, PLAIN).astype(np.float32)
    seen = np.where(LIPS > 0.3, seen_lips, 1.0).astype(np.float32)
    return complete_skin(LIPS_CHART, colour, seen, PLAIN, None).colour


def test_the_inside_of_closed_lips_is_lip() -> None:
    """It was skin: a pale stripe as soon as the mouth opens."""
    lower = LIPS > 0.6
    middle = np.median(ROWS[lower])
    outer = lower & (np.abs(ROWS - middle) > 4)
    hidden = (LIPS > 0.9) & ~outer & (INSIDE < 0.1)
    found = completed(outer.astype(np.float32))[hidden]
    assert hidden.sum() > 50
    assert np.abs(np.median(found, 0) - RED).max() < 0.03


@pytest.mark.parametrize("seen", [0.0, 1.0])
def test_heads_without_lips_are_completed_as_before(seen: float) -> None:
    """Imported heads name fewer regions; a mean over none divides by nothing."""
    head = sphere_head(24, 48)
    chart = Chart.build(head, 96, 64)
    count = len(chart.texels)
    share = np.full(count, seen, np.float32)
    with np.errstate(all="raise", under="ignore"):
        colour = complete_skin(chart, np.tile(PLAIN, (count, 1)), share, PLAIN, None).colour
    own = chart.inner_part == head.part_names.index("skin")
    assert np.abs(colour[own] - PLAIN).max() < 0.05
