"""Height of an opening: the lowest row of the upper edge over the highest of the lower one."""

import numpy as np
import pytest

from service.head.files import load_head
from service.head.regions import OpeningEdges, lid_edges


def test_the_rows_that_bound_it_count() -> None:
    """A lid is thick: measured at its front row alone, shut eyes stood open by millimetres."""
    x = np.array([-1.0, 0.0, 2.0])
    rows = [np.stack([x, np.full(3, y), np.zeros(3)], 1) for y in (3.0, 2.0, -1.0, 0.5)]
    edges = OpeningEdges((np.arange(3), np.arange(3, 6)), (np.arange(6, 9), np.arange(9, 12)))
    vertices = np.concatenate(rows)
    assert edges.height(vertices) == pytest.approx(1.5)
    vertices[3:6, 1] = 0.0
    assert edges.height(vertices) == pytest.approx(-0.5), "overlapping edges have a negative height"


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_blink_closes_the_head_in_the_box(side: str) -> None:
    head = load_head()
    edges = lid_edges(head, side)
    assert edges is not None
    blink = head.expression[head.expression_names.index(f"eyeBlink{side.capitalize()}")]
    assert edges.height(head.mean) > 5e-3
    assert edges.height(head.mean + blink) < 0.2e-3
