"""Which points of cost against loss are worth having, and how straight a line is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


def pareto(points: Sequence[Sequence[float]]) -> list[bool]:
    """Whether each point (every coordinate: smaller is better) is on the Pareto front.

    A point is off it where another is at least as good in every coordinate and better in one. Equal points are all on
    it. A point with a coordinate that is NaN is never on it.
    """
    if not points:
        return []
    table = np.asarray(points, np.float64)
    sound = np.asarray(~np.isnan(table).any(1))
    front = []
    for index, point in enumerate(table):
        others = table[sound]
        beaten = (others <= point).all(1) & (others < point).any(1)
        front.append(bool(sound[index] and not beaten.any()))
    return front


@dataclass(frozen=True)
class Line:
    """Least-squares line ``start + slope x``, and the largest distance of a point from it as a share of that point."""

    start: float
    slope: float
    worst: float


def line(x: Sequence[float], y: Sequence[float]) -> Line | None:
    """The line through points weighted by 1 / y, so that each counts by its relative error.

    None with fewer than three points, which every line fits, or with a y that is not above 0.
    """
    across, up = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(across) < 3 or not (up > 0).all() or np.ptp(across) == 0:
        return None
    design = np.stack([1 / up, across / up], 1)
    start, slope = np.linalg.lstsq(design, np.ones_like(up), rcond=None)[0]
    worst = float(np.abs((start + slope * across) / up - 1).max())
    return Line(float(start), float(slope), worst)
