"""The edges of the lids, where lashes grow: what a photo shows there is no relief of the skin."""

from __future__ import annotations

import numpy as np

from service.anatomy.opening_edges import lid_edges
from service.arrays import Float32
from service.geometry.chart import Chart

UPPER = (0.0, 0.25, 0.75, 0.6, 0.15)
LOWER = (0.0, 0.1, 0.35, 0.3, 0.1)
"""Density on the rows of vertices over the lid's thickness, from the socket outwards. The row at the socket stays
flesh; lower lashes are shorter, and stand before a pale rim."""


def lash_line(chart: Chart) -> Float32:
    """(N,) density of lashes at the inner texels, in [0, 1]; all 0 for heads that name no lids."""
    weight = np.zeros((len(chart.head.mean), 1), np.float32)
    for side in ("left", "right"):
        edges = lid_edges(chart.head, side)
        for rows, opacity in () if edges is None else ((edges.upper, UPPER), (edges.lower, LOWER)):
            for row, share in zip(rows, opacity, strict=False):
                weight[row, 0] = np.maximum(weight[row, 0], share)
    return np.asarray(chart.inside(weight)[:, 0], np.float32)
