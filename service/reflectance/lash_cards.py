"""Strips of lashes: without a cut-out they are drawn nowhere, but not every tool knows opacity.

Such a tool draws them whole. Dark ones look like a mask then; in the colour of the lids they hardly show.
"""

from __future__ import annotations

import numpy as np

from service.geometry.chart import NO_PART
from service.reflectance.planes import Codes
from service.reflectance.subject import Subject, margin

PART = "lashes"


def lids_on_lashes(albedo: Codes, subject: Subject) -> Codes:
    """The albedo, changed in place: the island of the lashes has the median colour of the lids.

    Args:
        albedo: (H, W, 3) codes.
        subject: whose head may lack lashes or lids; the albedo stays as it is then.
    """
    import cv2

    head, chart, (height, width) = subject.head, subject.chart, albedo.shape[:2]
    rows, columns = np.nonzero(subject.lids > 0.5)
    if PART not in head.part_names or not len(rows):
        return albedo
    places = [((at + 0.5) * size / of).astype(int) for at, size, of in
              ((rows, height, chart.height), (columns, width, chart.width))]  # fmt: skip
    colour = np.median(albedo[places[0], places[1]], axis=0)
    part, index, border = subject.islands((width, height)), head.part_names.index(PART), margin(width)
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
