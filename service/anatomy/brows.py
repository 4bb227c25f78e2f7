"""Where eyebrows may lie on the chart."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.geometry.chart import Chart
from service.head.regions import vertex_mask

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
