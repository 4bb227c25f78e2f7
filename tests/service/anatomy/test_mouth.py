"""Teeth, gums, tongue and lining: measured where they show, dark further in, and no division by nothing."""

from __future__ import annotations

import numpy as np

from service.anatomy.mouth import (
    Teeth,
    paint_lining,
)
from service.colour import linear_to_srgb
from service.face.features.mouth import TOOTH
from service.geometry.chart import Chart
from tests.toyhead import sphere_head

TEETH = linear_to_srgb(TOOTH)


def test_a_head_without_teeth_or_mouth_is_no_trouble() -> None:
    toy = Chart.build(sphere_head(12, 24), 96, 64)
    lining = paint_lining(toy, np.zeros(len(toy.texels), np.float32))
    assert np.isfinite(lining).all()
    assert np.isfinite(Teeth(toy).paint(TEETH)).all()
