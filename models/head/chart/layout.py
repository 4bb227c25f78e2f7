"""Where things lie in the image: the room for the seen skin, and the small islands in the lower corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.crop import PART_NAMES, Crop
from models.head.eyes import RINGS_DEG, SEGMENTS

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

WIDTH, HEIGHT = 6144, 4096
"""Pixels of the full-size image; the chart is laid out in these so that texels are square."""
MARGIN = 10.0
"""Pixels kept free on each side of an island: at least 20 between two of them."""
CORNER = ((1450.0, 0.0), (WIDTH / 2, 720.0))
"""Line, in pixels from the midline, that cuts off the corner for everything that is not seen skin."""


@dataclass
class Flat:
    """One island laid flat: polygons of the left half, their corners (Q, 4) into xy (N, 2) pixels; x = 0 is the
    midline.
    """

    name: str
    polygons: Int
    corners: Int
    xy: Float
    on_midline: npt.NDArray[np.bool_]


def walls() -> Float:
    """The right half of the image without its lower corner; the midline itself is kept by pins."""
    (x0, y0), (x1, y1) = CORNER
    length = np.hypot(x1 - x0, y1 - y0)
    a, b = (y0 - y1) / length, (x1 - x0) / length
    return np.array(
        [
            [-1.0, 0.0, WIDTH / 2 - MARGIN],
            [0.0, 1.0, -MARGIN],
            [0.0, -1.0, HEIGHT - MARGIN],
            [a, b, -(a * x0 + b * y0) - MARGIN],
        ]
    )


def eye_disc(crop: Crop, part: int, polygons: Int, radius: float) -> Flat:
    """The eyeball as a disc around the line of sight, the front enlarged; the back pole becomes the rim."""
    corners = crop.polygons[polygons]
    first = int(np.unique(corners[corners >= 0])[0])
    local = np.where(corners < 0, -1, corners - first)
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    rings: list[Float] = [np.zeros((1, 2))]
    for theta in RINGS_DEG:
        reach = radius * (1 - (1 - theta / 180) ** 2)  # the iris gets twice the even share
        rings.append(reach * np.stack([np.cos(angle), np.sin(angle)], 1))
    between = angle + np.pi / SEGMENTS
    rings.append(radius * np.stack([np.cos(between), np.sin(between)], 1))
    last = 1 + len(RINGS_DEG) * SEGMENTS
    out = local.copy()
    for row in np.flatnonzero((local == last).any(1)):  # each triangle at the back pole gets its own rim point
        a = local[row, 2]  # (pole, after, here): the rim point beside "here"
        out[row, 0] = last + (a - (1 + (len(RINGS_DEG) - 1) * SEGMENTS))
    return Flat(PART_NAMES[part], polygons, out, np.concatenate(rings), np.zeros(last + SEGMENTS, bool))


def upright(flat: Flat) -> Flat:
    """Turn a free island so that its bounding box is flat and wide, then move its corner to the origin."""
    best = min(
        np.radians(np.arange(0, 180, 3.0)),
        key=lambda a: np.ptp(flat.xy @ np.array([-np.sin(a), np.cos(a)])),
    )
    c, s = np.cos(best), np.sin(best)
    flat.xy = flat.xy @ np.array([[c, -s], [s, c]])
    flat.xy -= flat.xy.min(0)
    return flat


def place(flats: list[Flat]) -> None:
    """Move the small islands into the lower right corner: tallest first, each as low and as far right as it fits.

    Raises:
        ValueError: an island does not fit.
    """
    (x0, y0), (x1, y1) = CORNER
    taken: list[tuple[float, float, float, float]] = []
    small = [flat for flat in flats if flat.name != "face"]
    for flat in sorted(small, key=lambda f: -float(np.ptp(f.xy[:, 1]))):
        width, height = np.ptp(flat.xy, axis=0) + 2 * MARGIN
        spot = None
        for y in np.arange(0.0, y1, 4.0):
            for x in np.arange(WIDTH / 2 - width, x0, -4.0):
                ceiling = y0 + (y1 - y0) * (x - x0) / (x1 - x0)
                free = all(x >= c or x + width <= a or y >= d or y + height <= b for a, b, c, d in taken)
                if y + height <= ceiling and free:
                    spot = (x, y)
                    break
            if spot:
                break
        if spot is None:
            raise ValueError(f"no room for island {flat.name} of {width:.0f} x {height:.0f} pixels")
        taken.append((spot[0], spot[1], spot[0] + width, spot[1] + height))
        flat.xy += np.array(spot) + MARGIN - flat.xy.min(0)
