"""Strips of lashes: without a cut-out they are drawn nowhere, but not every tool knows opacity.

Such a tool draws them whole. Dark ones look like a mask then; in the colour of the lids they hardly show.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.eyes.lids import lid_skin
from service.colour import Codes
from service.geometry.chart import NO_PART, Chart, islands

PART = "lashes"


def colour_cards(albedo: Codes, chart: Chart, border: int) -> Codes:
    """The albedo, changed in place: the island of the lashes has the median colour of the lids.

    Args:
        albedo: (H, W, 3) codes.
        chart: of the head, at any size; the albedo stays as it is where the head has no lashes or lids.
        border: texels of the map by which the island grows.
    """
    import cv2

    head, (height, width) = chart.head, albedo.shape[:2]
    rows, columns = np.nonzero(lid_skin(chart) > 0.5)
    if PART not in head.part_names or not len(rows):
        return albedo
    places = [((at + 0.5) * size / of).astype(int) for at, size, of in
              ((rows, height, chart.height), (columns, width, chart.width))]  # fmt: skip
    colour = np.median(albedo[places[0], places[1]], axis=0)
    part, index = islands(head, (width, height)), head.part_names.index(PART)
    inside = part == index
    # Only where the strips are: the whole map is large, and they are a small corner of it.
    box = tuple(
        slice(max(int(found[0]) - border, 0), int(found[-1]) + border + 1)
        for found in (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    )
    grown = cv2.dilate(inside[box].astype(np.uint8), np.ones((3, 3), np.uint8), iterations=border)
    chosen = (np.asarray(grown) > 0) & (inside[box] | (part[box] == NO_PART))
    albedo[box][chosen] = np.rint(colour).astype(albedo.dtype)
    return albedo
