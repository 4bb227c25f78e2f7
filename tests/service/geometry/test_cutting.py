from __future__ import annotations

import numpy as np
import pytest

from service.geometry.cutting import clipped, split


def test_a_triangle_is_cut_along_the_line_and_split_in_four() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    both = np.array([[0, 1, 2], [1, 3, 2]])
    area = lambda p, t: 0.5 * np.abs(np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]])[:, 2]).sum()  # noqa: E731
    for x in (0.25, 0.6):
        points, triangles = clipped(corners, both, x - corners[:, 0])
        assert area(points, triangles) == pytest.approx(x)
        assert points[:, 0].max() == pytest.approx(x)
    points, triangles = split(corners, both, np.array([True, False]))
    assert len(triangles) == 5 and area(points, triangles) == pytest.approx(1.0)
    assert (triangles[-1] == both[1]).all(), "order stays"
    nothing, none = clipped(corners, both, -np.ones(4))
    assert len(none) == 0 and len(nothing) == 0
