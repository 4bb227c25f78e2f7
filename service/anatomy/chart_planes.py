"""Where eyebrows, lids and lashes lie on the chart."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.geometry.chart import Chart
from service.head.regions import lid_edges, vertex_mask

REACH = 1 / 192
"""How far a person's brows may lie from the head model's, as a share of the chart's width: 2 mm."""

CERTAIN = 0.3
"""Value of the model's soft mask from which the result is 1."""


def brow_plane(chart: Chart) -> Float32:
    """(h, w) float32 mask in [0, 1]: the head's brow regions dilated by ``REACH``; all 0 if it names none."""
    import cv2

    radius = max(round(chart.width * REACH), 1)
    soft = chart.interpolate(vertex_mask(chart.head, "brow_left", "brow_right")[:, None])[..., 0] * chart.mask
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.dilate(np.clip(soft / np.float32(CERTAIN), 0, 1).astype(np.float32), kernel))


def lid_skin(chart: Chart) -> Float32:
    """(h, w) float32 >= 0: weight of the eyelids; 0 where the head names none."""
    weight = chart.interpolate(vertex_mask(chart.head, "eyelid_left", "eyelid_right"))[..., 0]
    return np.asarray(weight * chart.mask, np.float32)


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
