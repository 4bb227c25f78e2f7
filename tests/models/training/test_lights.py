"""Mixtures of lights, and the loss that sees what is left of a shadow's edge."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.colour import linear  # noqa: E402
from models.training.lights import edge_loss, mixed  # noqa: E402
from models.training.tasks import byte  # noqa: E402

pytestmark = pytest.mark.train


def test_light_adds_up_in_linear_values() -> None:
    """A mixture of coded values would be too dark by up to a third between black and white."""
    texture = np.stack([np.zeros((3, 4, 6), np.uint8), np.full((3, 4, 6), 255, np.uint8)])
    item = {"texture": texture, "albedo": texture[0]}
    half = mixed(item, 0, 1, 0.5)["texture"]
    assert float(linear(byte(half[0])).mean()) == pytest.approx(0.5, abs=0.005)
    assert np.array_equal(half[1], texture[1]) and not texture[0].any(), "the capture itself is left alone"
    assert np.array_equal(mixed(item, 1, 0, 0.0)["texture"], texture)


def test_an_edge_costs_more_than_the_same_error_spread_evenly() -> None:
    truth, mask = torch.full((1, 3, 16, 24), 0.5), torch.ones(1, 1, 16, 24)
    step = truth.clone()
    step[..., 12:] += 0.2
    assert float(edge_loss(truth + 0.1, truth, mask)) == pytest.approx(0.0, abs=1e-6)
    assert float(edge_loss(step, truth, mask)) > 0.01
    assert float(edge_loss(step, truth, 0 * mask)) == 0.0, "a chart without skin must not divide by zero"
