"""Tones of the benchmark of fairness: each has its class's angle, and only melanin differs."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("skimage")

from benchmarks.albedo import typology_angle
from benchmarks.fairness import CLASSES, MELANIN, WHITEST, toned
from service.colour import linear_to_srgb

pytestmark = pytest.mark.train


@pytest.mark.parametrize(("name", "angle"), CLASSES)
def test_each_class_has_its_angle_by_melanin_alone(name: str, angle: float) -> None:
    rng = np.random.default_rng(0)
    colours = np.array([0.40, 0.24, 0.16]) * rng.uniform(0.8, 1.1, (500, 1))
    made = toned(colours, angle, np.ones(500, bool))
    coded = linear_to_srgb(made.mean(0).astype(np.float32)).astype(np.float64)
    assert typology_angle(coded) == pytest.approx(angle, abs=2.0), name
    depth = -np.log(made / colours) / MELANIN
    free = made.max(1) < WHITEST
    assert np.allclose(depth[free], depth[free].mean(), atol=1e-6), "one depth for all of the skin"
