"""Albedo of the tongue and of the lining of the mouth, darker the deeper they lie."""

from __future__ import annotations

import numpy as np

from service.anatomy.mouth.colours import LINING, TONGUE
from service.arrays import AnyFloat, Float32, Int64
from service.colour import linear_to_srgb
from service.geometry.chart import Chart

HALF_DEPTH_M = {"tongue": 0.020, "lining": 0.045}
"""Metres behind the foremost point of each at which its sRGB values have halved. The lining stays dark red: how little
light reaches the throat is the renderer's."""


def shade(depth: AnyFloat, half: float) -> Float32:
    """(N, 1) factor in (0, 1] on sRGB values at depths (N,) behind the front: 1/2 at ``half``, 1 at depths below 0."""
    return np.asarray(1.0 / (1.0 + (np.maximum(depth, 0.0) / half) ** 1.5), np.float32)[:, None]


def part_points(chart: Chart, index: int, texels: Int64) -> tuple[AnyFloat, AnyFloat]:
    """(n, 3) points of texels and (M, 3) vertices of part ``index``, metres on the neutral mean head."""
    head = chart.head
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]])
    return points, head.mean[np.unique(head.triangles[head.triangle_part == index])]


def paint_tongue(chart: Chart, index: int, texels: Int64) -> Float32:
    """(n, 3) sRGB-coded albedo of the tongue at texels (n,) of part ``index``, darker towards the throat."""
    points, vertices = part_points(chart, index, texels)
    depth = vertices[:, 2].max() - points[:, 2]
    return np.asarray(linear_to_srgb(TONGUE) * shade(depth, HALF_DEPTH_M["tongue"]), np.float32)


def paint_lining(chart: Chart, mouth: Float32) -> Float32:
    """(N, 3) sRGB-coded albedo of the lining at all inner texels; ``mouth`` (N,) > 0.5 marks those on it."""
    head = chart.head
    inside = mouth > 0.5
    depth = np.zeros(len(mouth))
    if inside.any():
        z = np.einsum("nk,nk->n", chart.weights[inside], head.mean[chart.corners[inside], 2])
        depth[inside] = z.max() - z
    return np.asarray(linear_to_srgb(LINING) * shade(depth, HALF_DEPTH_M["lining"]), np.float32)
