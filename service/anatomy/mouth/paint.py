"""Tongue and lining of the mouth: their albedo, darker the further in."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.mouth.colours import LINING, TONGUE
from service.colour import linear_to_srgb
from service.geometry.chart import Chart

Float = npt.NDArray[np.float32]
Points = npt.NDArray[np.floating]

HALF_DEPTH_M = {"tongue": 0.020, "lining": 0.014}
"""Depth behind the front of each at which it is half as bright, on sRGB values."""


def shade(depth: npt.NDArray[np.floating], half: float) -> Float:
    """(N, 1) factor in (0, 1] on sRGB values of points (N,) metres behind the front; 1 before it."""
    return np.asarray(1.0 / (1.0 + (np.maximum(depth, 0.0) / half) ** 1.5), np.float32)[:, None]


def part_points(chart: Chart, index: int, texels: npt.NDArray[np.int64]) -> tuple[Points, Points]:
    """(n, 3) points of texels, and (M, 3) vertices of their part, in metres on the neutral mean head."""
    head = chart.head
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]])
    return points, head.mean[np.unique(head.triangles[head.triangle_part == index])]


def paint_tongue(chart: Chart, index: int, texels: npt.NDArray[np.int64]) -> Float:
    """(n, 3) sRGB-coded albedo, darker towards the throat."""
    points, vertices = part_points(chart, index, texels)
    depth = vertices[:, 2].max() - points[:, 2]
    return np.asarray(linear_to_srgb(TONGUE) * shade(depth, HALF_DEPTH_M["tongue"]), np.float32)


def paint_lining(chart: Chart, mouth: Float) -> Float:
    """(N, 3) sRGB-coded albedo of the lining at all inner texels; ``mouth`` (N,) says which are on it."""
    head = chart.head
    own = mouth > 0.5
    depth = np.zeros(len(mouth))
    if own.any():
        z = np.einsum("nk,nk->n", chart.weights[own], head.mean[chart.corners[own], 2])
        depth[own] = z.max() - z
    return np.asarray(linear_to_srgb(LINING) * shade(depth, HALF_DEPTH_M["lining"]), np.float32)
