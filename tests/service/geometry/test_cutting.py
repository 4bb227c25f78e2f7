from __future__ import annotations

import numpy as np
import pytest

from service.arrays import Float64, Int64
from service.geometry.cutting import clipped, split


def area(points: Float64, triangles: Int64) -> float:
    first, second, third = (points[corner] for corner in triangles.T)
    return 0.5 * float(np.abs(np.cross(second - first, third - first)[:, 2]).sum())


def test_a_triangle_is_cut_along_the_line_and_split_in_four() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    both = np.array([[0, 1, 2], [1, 3, 2]])
    for x in (0.25, 0.6):
        points, triangles = clipped(corners, both, x - corners[:, 0])
        assert area(points, triangles) == pytest.approx(x)
        assert points[:, 0].max() == pytest.approx(x)
    points, triangles = split(corners, both, np.array([True, False]))
    assert len(triangles) == 5 and area(points, triangles) == pytest.approx(1.0)
    assert (triangles[-1] == both[1]).all(), "order stays"
    nothing, none = clipped(corners, both, -np.ones(4))
    assert len(none) == 0 and len(nothing) == 0
