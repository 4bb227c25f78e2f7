"""Lips that a photo hides have the colour of those that it shows."""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.texture.inpainting import complete_skin
from tests.toyhead import sphere_head

HEAD = load_head()
CHART = Chart.build(HEAD, 384, 256)
SKIN, RED = np.array([0.75, 0.59, 0.51], np.float32), np.array([0.70, 0.35, 0.36], np.float32)
LIPS = CHART.inside(vertex_mask(HEAD, "lips")[:, None])[:, 0]
INSIDE = CHART.inside(vertex_mask(HEAD, "mouth_inner")[:, None])[:, 0]
ROWS = CHART.texels // CHART.width


def completed(seen_lips: np.ndarray) -> np.ndarray:
    """Colours (N, 3) when all skin is seen but lips only where told."""
    colour = np.where((LIPS > 0.6)[:, None], RED, SKIN).astype(np.float32)
    seen = np.where(LIPS > 0.3, seen_lips, 1.0).astype(np.float32)
    return complete_skin(CHART, colour, seen, SKIN, None).colour


def test_the_inside_of_closed_lips_is_lip() -> None:
    """It was skin: a pale stripe as soon as the mouth opens."""
    lower = LIPS > 0.6
    middle = np.median(ROWS[lower])
    outer = lower & (np.abs(ROWS - middle) > 4)
    hidden = (LIPS > 0.9) & ~outer & (INSIDE < 0.1)
    found = completed(outer.astype(np.float32))[hidden]
    assert hidden.sum() > 50
    assert np.abs(np.median(found, 0) - RED).max() < 0.03


def test_skin_beside_the_lips_stays_skin_and_unseen_lips_are_not_made_up() -> None:
    """Without any lip seen (a mask) no colour of lips is known."""
    none = completed(np.zeros(len(LIPS), np.float32))
    assert np.isfinite(none).all()
    assert np.abs(np.median(none[LIPS > 0.9], 0) - SKIN).max() < 0.03
    some = completed((np.median(ROWS[LIPS > 0.6]) < ROWS).astype(np.float32))
    skin = (LIPS < 0.01) & (CHART.inner_part == 0)
    assert np.abs(some - none)[skin].max() < 0.02


@pytest.mark.parametrize("seen", [0.0, 1.0])
def test_heads_without_lips_are_completed_as_before(seen: float) -> None:
    """Imported heads name fewer regions; a mean over none divides by nothing."""
    head = sphere_head(24, 48)
    chart = Chart.build(head, 96, 64)
    count = len(chart.texels)
    share = np.full(count, seen, np.float32)
    with np.errstate(all="raise", under="ignore"):
        colour = complete_skin(chart, np.tile(SKIN, (count, 1)), share, SKIN, None).colour
    own = chart.inner_part == head.part_names.index("skin")
    assert np.abs(colour[own] - SKIN).max() < 0.05
