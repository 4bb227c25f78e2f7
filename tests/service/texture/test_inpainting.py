"""What the photo does not show."""

from __future__ import annotations

import numpy as np
import pytest

from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.texture.inpainting import complete_skin
from tests.toyhead import sphere_head

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
    return complete_skin(LIPS_CHART, colour, seen, PLAIN).colour


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
        colour = complete_skin(chart, np.tile(PLAIN, (count, 1)), share, PLAIN).colour
    own = chart.inner_part == head.part_names.index("skin")
    assert np.abs(colour[own] - PLAIN).max() < 0.05


def test_skin_that_is_hidden_beside_brows_is_not_dark() -> None:
    """Under a fringe or a brim the brows' darkness was continued over the forehead."""
    brow = int(0.29 * LIPS_CHART.height)
    dark = np.abs(ROWS - brow) < 4
    colour = np.where(dark[:, None], 0.2 * PLAIN, PLAIN).astype(np.float32)
    seen = (brow - 3 < ROWS).astype(np.float32)
    above = brow - 10 > ROWS
    skin = LIPS_CHART.inner_part == HEAD.part_names.index("skin")
    told = complete_skin(LIPS_CHART, colour, seen, PLAIN, 1 - dark.astype(np.float32)).colour
    smeared = complete_skin(LIPS_CHART, colour, seen, PLAIN).colour
    assert np.abs(told[above & skin] - PLAIN).max() < 0.03 < np.abs(smeared[above & skin] - PLAIN).max()


def test_skin_that_a_hat_hides_is_as_the_face_is_and_not_as_dark_as_its_shadow() -> None:
    """The shadow below the brim was continued over the forehead: a black smear from the eyes to the crown."""
    brim = int(0.29 * LIPS_CHART.height)
    worn = (brim > ROWS).astype(np.float32)
    shaded = (brim <= ROWS) & (brim + 12 > ROWS)
    colour = np.where(shaded[:, None], 0.2 * PLAIN, PLAIN).astype(np.float32)
    hidden = (brim - 10 > ROWS) & (LIPS_CHART.inner_part == HEAD.part_names.index("skin"))
    given = LIPS_CHART, colour, 1 - worn, PLAIN
    told, smeared = (complete_skin(*given, worn=by).colour[hidden] for by in (worn, 0.0))
    assert np.abs(told - PLAIN).mean() < 0.02
    assert np.abs(smeared - PLAIN).mean() > 0.15
