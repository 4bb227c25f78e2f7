"""The albedo beyond the islands of the chart.

A network speaks there too, of texels that it has never been asked about; another network would read the step at an
island's border as a crease. So the skin goes on from inside, as in the texture.
"""

from __future__ import annotations

import numpy as np

from service.geometry.chart import NO_PART, nearest_inside
from service.reflectance.planes import Codes
from service.reflectance.subject import Subject
from service.reflectance.texels import interpolated

STRIP = 256
"""Rows of the full map at a time."""


def skin_goes_on(albedo: Codes, subject: Subject) -> Codes:
    """The albedo, changed in place: texels outside all islands that lie next to skin have the colour of that skin.

    Args:
        albedo: (H, W, 3) codes.
        subject: whose chart it is; without a cell of skin the albedo stays as it is.
    """
    import cv2

    height, width = albedo.shape[:2]
    chart, skin = subject.chart, subject.head.part_names.index("skin")
    inside = cv2.erode((chart.part == skin).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if not np.any(inside):
        return albedo
    small = np.asarray(cv2.resize(albedo, (chart.width, chart.height), interpolation=cv2.INTER_AREA), np.float32)
    colour = small.reshape(-1, 3)[nearest_inside(np.asarray(inside)).ravel()].reshape(small.shape)
    next_to = chart.part.ravel()[nearest_inside(chart.mask)] == skin
    planes = np.concatenate([np.moveaxis(colour, 2, 0), next_to.reshape(1, *inside.shape).astype(np.float32)])
    outside = subject.islands((width, height)) == NO_PART
    columns = np.arange(width)
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        chosen = outside[rows]
        if not chosen.any():
            continue
        fill = np.stack([interpolated(plane, (width, height), rows, columns) for plane in planes], 2)
        chosen &= fill[..., 3] > 0.999
        albedo[rows[0] : rows[-1] + 1][chosen] = np.rint(fill[..., :3][chosen]).astype(albedo.dtype)
    return albedo
