"""Albedo of the lash cards, the strips of mesh that carry the lashes.

Opacity should cut the lashes out of their card, but a tool without support for opacity draws the whole card. A dark
card would look like a mask; in the colour of the lids it hardly shows.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.eyes.lids import lid_skin
from service.colour import Codes
from service.geometry.chart import NO_PART, Chart, islands

PART = "lashes"


def colour_cards(albedo: Codes, chart: Chart, border: int) -> Codes:
    """The albedo, changed in place: the island of the lash cards has the median colour of the lids.

    Args:
        albedo: (H, W, 3) codes.
        chart: of the head, at any size; the albedo stays as it is where the head has no lashes or lids.
        border: texels of the map by which the island is dilated.
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
    # Within their bounding box only: it is a small corner of a large map.
    box = tuple(
        slice(max(int(found[0]) - border, 0), int(found[-1]) + border + 1)
        for found in (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    )
    grown = cv2.dilate(inside[box].astype(np.uint8), np.ones((3, 3), np.uint8), iterations=border)
    chosen = (np.asarray(grown) > 0) & (inside[box] | (part[box] == NO_PART))
    albedo[box][chosen] = np.rint(colour).astype(albedo.dtype)
    return albedo
