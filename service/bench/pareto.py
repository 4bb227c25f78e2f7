"""Pareto front of cost against loss, and the fit of a straight line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


def pareto(points: Sequence[Sequence[float]]) -> list[bool]:
    """Whether each point (every coordinate: smaller is better) is on the Pareto front.

    A point is dominated where another is at least as good in every coordinate and better in one. Equal points are all
    on the front. A point with a NaN is never on it.
    """
    if not points:
        return []
    table = np.asarray(points, np.float64)
    sound = np.asarray(~np.isnan(table).any(1))
    front = []
    for index, point in enumerate(table):
        others = table[sound]
        dominated = (others <= point).all(1) & (others < point).any(1)
        front.append(bool(sound[index] and not dominated.any()))
    return front


@dataclass(frozen=True)
class Line:
    """Least-squares line ``start + slope x``, and the largest relative deviation of a point from it."""

    start: float
    slope: float
    worst: float


def line(x: Sequence[float], y: Sequence[float]) -> Line | None:
    """Least-squares line through points weighted by 1 / y, which minimises relative errors.

    None with fewer than three points, which a line fits exactly, or with a y that is not above 0.
    """
    across, up = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(across) < 3 or not (up > 0).all() or np.ptp(across) == 0:
        return None
    design = np.stack([1 / up, across / up], 1)
    start, slope = np.linalg.lstsq(design, np.ones_like(up), rcond=None)[0]
    worst = float(np.abs((start + slope * across) / up - 1).max())
    return Line(float(start), float(slope), worst)
