"""Teeth, gums, tongue and lining: measured where they show, dark further in, and no division by nothing."""

from __future__ import annotations

import numpy as np

from service.anatomy.canvas import Canvas
from service.anatomy.items import read_insets
from service.anatomy.mouth import OPEN_SIZE, Teeth, open_picture, paint_lining
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


def test_molars_lie_in_the_shade_of_the_cheeks() -> None:
    rows = [mesh for mesh in read_insets().meshes if mesh.name.startswith("teeth")]
    share, front = open_picture(rows).ravel() / 255, max(row.rest[:, 2].max() for row in rows)
    for row in rows:
        at, depth = Canvas(OPEN_SIZE).texels(row.uv, row.uv_faces, row.faces, front - row.rest[:, 2:])
        assert share[at[depth[:, 0] < 0.003]].min(initial=1) > 0.9
        assert share[at[depth[:, 0] > 0.025]].max() < 0.3
