"""Colours of eyes, teeth and mouth, and the maps of the shape."""

from __future__ import annotations

import numpy as np

from service.geometry.chart import Chart
from service.texture.texture import shape_normals
from tests.toyhead import sphere_head

HEAD = sphere_head(24, 48)
CHART = Chart.build(HEAD, 192, 128)


def test_a_nose_shows_in_the_tangent_map_and_a_plain_sphere_does_not() -> None:
    vertices = HEAD.mean.astype(float)
    skin = np.unique(HEAD.triangles[HEAD.triangle_part == 0])
    plain_map = shape_normals(CHART, vertices)[1]
    bump = np.exp(-((vertices[:, 0] / 0.02) ** 2) - ((vertices[:, 1] + 0.02) / 0.02) ** 2) * (vertices[:, 2] > -0.05)
    vertices[skin, 2] += 0.02 * bump[skin]
    inside = CHART.part == 0
    rows = np.nonzero(inside)[0]
    middle = inside & (np.abs(np.arange(128)[:, None] - np.median(rows)) < 25)
    assert plain_map[middle][:, 2].min() > 0.97
    nose = shape_normals(CHART, vertices)[1]
    column = np.arange(192)[None, :] + 0.5
    right = middle & (column > 96) & (column < 108)
    assert nose[middle][:, 2].min() < 0.95
    assert nose[right][:, 0].max() > 0.2  # its left flank (u to the right) turns towards +u
