"""Teeth, gums, tongue and lining: measured where they show, dark further in, and no division by nothing."""

from __future__ import annotations

import numpy as np
import pytest

from service.anatomy.mouth import (
    WHITEST,
    Teeth,
    crown_share,
    no_bluer,
    paint_lining,
)
from service.colour import linear_to_srgb, srgb_to_linear
from service.face.features.mouth import TOOTH
from service.geometry.chart import Chart
from tests.toyhead import sphere_head

UP = np.array([0.0, 1.0, 0.0])
TEETH = linear_to_srgb(TOOTH)


def test_crowns_end_a_centimetre_from_the_biting_edge() -> None:
    """Of both rows, whatever height the edge has: lower molars bite above lower incisors."""
    x = np.linspace(-0.02, 0.02, 9)
    edge = np.stack([x, -0.06 + 10 * x**2, np.zeros(9)], 1)
    for upper, sign in ((True, 1.0), (False, -1.0)):
        near, far = edge + sign * 0.005 * UP, edge + sign * 0.013 * UP
        vertices = np.concatenate([edge, far])
        assert (crown_share(near, vertices, upper=upper)[1:-1] == 1).all()
        assert (crown_share(far, vertices, upper=upper)[3:6] == 0).all()
    alone = crown_share(np.array([[1.0, 0, 0]]), edge, upper=True)
    assert np.isfinite(alone).all()


def test_a_head_without_teeth_or_mouth_is_no_trouble() -> None:
    toy = Chart.build(sphere_head(12, 24), 96, 64)
    lining = paint_lining(toy, np.zeros(len(toy.texels), np.float32))
    assert np.isfinite(lining).all()
    assert np.isfinite(Teeth(toy).paint(TEETH)).all()


def test_teeth_do_not_turn_cyan_by_the_light_of_redder_eyes() -> None:
    """Without the bound, overexposed teeth divided by warm light have more blue than red; others stay as they are."""
    albedo = np.array([[0.8, 0.9, 1.0], [0.8, 0.72, 0.6], [0.0, 0.0, 0.0]], np.float32)
    kept = no_bluer(albedo)
    bare = srgb_to_linear(kept)
    assert (bare[0, 1:] <= bare[0, 0] * np.array(WHITEST) + 1e-4).all()
    assert kept[0, 0] == pytest.approx(0.8, abs=1e-4), "red stays"
    assert kept[1:] == pytest.approx(albedo[1:], abs=1e-4)
