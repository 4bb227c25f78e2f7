"""Grain of made-up skin."""

from __future__ import annotations

import numpy as np

from service.geometry.chart import Chart, mirrored_map
from service.head.files import load_head
from service.texture.inpainting import grain

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


def test_grain_is_symmetric_seeded_and_of_mean_magnitude_one() -> None:
    assert abs(float(np.abs(GRAIN).mean()) - 1) < 1e-3 and np.isfinite(GRAIN).all()
    both = SKIN & mirrored_map(SKIN)
    assert np.corrcoef(MAP[both], mirrored_map(MAP)[both])[0, 1] > 0.8, "both ends of the chart meet behind the head"
    assert np.array_equal(grain(CHART, 0), GRAIN) and not np.array_equal(grain(CHART, 1), GRAIN)


def test_tiny_charts_have_finite_grain() -> None:
    """A texel of several centimetres is beyond the coarsest octave."""
    assert np.isfinite(grain(Chart.build(CHART.head, 24, 16), 0)).all()
