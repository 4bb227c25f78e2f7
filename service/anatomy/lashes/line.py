"""The dark line of the lashes along the edges of the lids.

In a photo it is one or two pixels wide and lies on the underside of the lid, which faces no camera; so the texture
loses it, and eyes look bare. It is painted where the photo does not show the edge of a lid squarely.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.opening_edges import lid_edges
from service.arrays import Float32
from service.geometry.chart import Chart
from service.ledger import Constant, Correction

COLOUR = np.array([0.0143, 0.0092, 0.0077], np.float32)
"""Diffuse albedo of lashes, linear RGB."""

UPPER = (0.0, 0.25, 0.75, 0.6, 0.15)
LOWER = (0.0, 0.1, 0.35, 0.3, 0.1)
"""Opacity on the rows of vertices over the lid's thickness, from the socket outwards. The row at the socket stays
flesh; lower lashes are shorter, and stand before a pale rim."""


def lash_line(chart: Chart) -> Float32:
    """(N,) opacity of the line at the inner texels, in [0, 1]; all 0 for heads that name no lids."""
    weight = np.zeros((len(chart.head.mean), 1), np.float32)
    for side in ("left", "right"):
        edges = lid_edges(chart.head, side)
        for rows, opacity in () if edges is None else ((edges.upper, UPPER), (edges.lower, LOWER)):
            for row, share in zip(rows, opacity, strict=False):
                weight[row, 0] = np.maximum(weight[row, 0], share)
    return np.asarray(chart.inside(weight)[:, 0], np.float32)


LASH_LINE = Correction(
    name="lash-line",
    mends="The texture loses the line of the lashes on the underside of the lid, and eyes look bare.",
    source="texture",
    constants={
        "upper": Constant(UPPER, "opacity by row of vertices from the socket outwards", "chosen by eye"),
        "lower": Constant(LOWER, "opacity by row of vertices from the socket outwards", "chosen by eye"),
    },
)
