"""Light between the lids, against rays through triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.head.files import load_head
from service.light.formulas import Graphs
from service.light.scene import PointLight
from service.render.visibility import Detail, Eyes, Visibility

HEAD = load_head(None)
SIZE = (768, 512)
CASTS = np.array([name.split("_")[0] in ("skin", "eye") for name in HEAD.part_names])[HEAD.triangle_part]
Array = npt.NDArray[np.floating[Any]]


def _free(start: Array, end: Array, triangles: Array) -> npt.NDArray[np.bool_]:
    """(N,) whether nothing lies between points start (N, 3) and end (3,): Moeller and Trumbore, 1997."""
    a, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    free = np.ones(len(start), bool)
    for i, point in enumerate(start):
        ray = end - point
        across = np.cross(ray, second)
        scale = (first * across).sum(1)
        scale = np.where(np.abs(scale) < 1e-12, np.inf, scale)
        u = ((point - a) * across).sum(1) / scale
        around = np.cross(point - a, first)
        v, t = (ray * around).sum(1) / scale, (second * around).sum(1) / scale
        free[i] = not ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any()
    return free


def test_lamps_reach_the_eyes_between_the_lids() -> None:
    """On the coarse chart lids cast shadows as wide as the slit between them, and eyes were black."""
    chart = Chart.build(HEAD, *SIZE)
    eyes = [index for index, name in enumerate(HEAD.part_names) if name.startswith("eye")]
    own = np.flatnonzero(np.isin(chart.inner_part, eyes))
    normal = chart.normals(HEAD.mean).reshape(-1, 3)[chart.texels][own].astype(float)
    place = chart.inside(HEAD.mean)[own] + 2e-4 * normal
    triangles = HEAD.mean[HEAD.triangles[CASTS]].astype(float)
    shown = np.flatnonzero(normal[:, 2] > 0.6)[::5]
    shown = shown[_free(place[shown], np.array([0, -0.03, 1.2]), triangles)]
    assert len(shown) > 20
    visibility = Visibility(HEAD, HEAD.mean, Graphs())
    away = []
    for at in ((0.0, 0.0, 1.2), (0.3, 0.1, 1.0), (-0.5, 0.3, 0.8)):
        lamp = visibility.shadow(PointLight(at, (1.0, 1.0, 1.0), 0.0), SIZE).ravel()[chart.texels][own][shown]
        away.append(np.abs(lamp - _free(place[shown], np.array(at), triangles)).mean())
    assert np.mean(away) < 0.11, f"{away}; looked at as coarsely as the skin: 0.15"


def test_only_the_eyes_are_looked_at_closely() -> None:
    eyes = Eyes.of(Chart.build(HEAD, *SIZE), HEAD.mean, CASTS, 2.0)
    assert eyes is not None
    image = eyes.over(np.zeros((128, 192, 2), np.float32), np.ones((len(eyes.index), 2), np.float32))
    part = Chart.build(HEAD, 192, 128).part
    there = np.isin(part, [i for i, name in enumerate(HEAD.part_names) if name.startswith("eye")])
    assert image[there].mean() > 0.7 and image[part == HEAD.part_names.index("skin")].mean() < 0.01
    assert set(np.unique(image)) <= {0.0, 1.0}, "the border of an eye must not be darkened"


def test_a_chart_without_texels_of_eyes_has_none() -> None:
    """A mean of no vertices would be NaN, and so would be the light."""
    assert Eyes.of(Chart.build(HEAD, 3, 2), HEAD.mean, CASTS, 5.0) is None
    visibility = Visibility(HEAD, HEAD.mean, Graphs(), Detail(16, (24, 16), (3, 2), (5.0, 9.0), 9.0, 24))
    assert np.isfinite(visibility.openness(np.ones((16, 24, 3), np.float32))).all()
