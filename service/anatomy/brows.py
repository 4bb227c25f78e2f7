"""Where brows may lie on the chart."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.head.regions import vertex_mask

Float = npt.NDArray[np.float32]

ASIDE = 1 / 192
"""How far beside the model's brows those of the photo may lie, as a share of the chart's width: 2 mm."""

SURE = 0.3
"""Value of the soft mask from which a texel counts as brow for certain."""


def brow_plane(chart: Chart) -> Float:
    """(h, w) float32 in [0, 1], 1 as far as brows may lie beside the head's; 0 if it names none."""
    import cv2

    radius = max(round(chart.width * ASIDE), 1)
    soft = chart.interpolate(vertex_mask(chart.head, "brow_left", "brow_right")[:, None])[..., 0] * chart.mask
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.dilate(np.clip(soft / np.float32(SURE), 0, 1).astype(np.float32), kernel))
