"""Loss of a map against another, the Pareto front of cost against loss, and a line through costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from service.arrays import Bool, Float32, Float64
from service.reflectance.reflectance_maps import unpack_normals

Kind = Literal["colour", "normal"]

SAME_DB = 99.0
"""PSNR reported for identical maps."""


def decibels(rms: float) -> float:
    """PSNR of a root mean square error of values in [0, 1], at most ``SAME_DB``."""
    return min(-20 * float(np.log10(max(rms, 1e-12))), SAME_DB)


def loss_of(kind: Kind, found: npt.NDArray[Any], reference: npt.NDArray[Any], mask: Bool) -> float:
    """Distance of a map from a reference of any other size; the smaller one is enlarged, so that lost detail counts.

    Args:
        kind: "colour": uint16 codes, 65535 = 1. "normal": (h, w, 2) int16 codes.
        found: (h, w, ...).
        reference: (H, W, ...) of the same part of the chart.
        mask: (H, W) texels that are compared; all of them where there is none.

    Returns:
        Root mean square of coded colours in [0, 1], or mean degrees of normals.
    """
    one, other = (_values(kind, codes, reference.shape[1::-1]) for codes in (found, reference))
    chosen = mask if mask.any() else np.ones_like(mask)
    if kind == "normal":
        return float(degrees(one[chosen], other[chosen]).mean())
    return float(np.sqrt(np.square(one[chosen] - other[chosen], dtype=np.float64).mean()))


def degrees(found: Float32, reference: Float32) -> Float64:
    """(...) angles between vectors (..., 3) of any length; 0 where one is zero. Accurate for small angles."""
    one, other = (np.asarray(vectors, np.float64) for vectors in (found, reference))
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("...i,...i->...", one, other))))


def _values(kind: Kind, codes: npt.NDArray[Any], size: tuple[int, int]) -> Float32:
    """Colours in [0, 1] or normals, resampled to (width, height) and not normalised again."""
    import cv2

    # OpenCV drops an axis of length 1; comparing maps with and without it would broadcast.
    plain = codes[..., 0] if codes.ndim == 3 and codes.shape[2] == 1 else codes
    values = unpack_normals(codes) if kind == "normal" else np.asarray(plain, np.float32) / np.float32(65535)
    if values.shape[1::-1] == size:
        return values
    way = cv2.INTER_AREA if size[0] <= values.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(values, size, interpolation=way), np.float32)


def pareto(points: Sequence[Sequence[float]]) -> list[bool]:
    """Whether each point (every coordinate: smaller is better) is on the Pareto front.

    A point is dominated where another is at least as good in every coordinate and better in one. Equal points are all
    on the front. A point with a NaN is never on it.
    """
    table = np.asarray(points, np.float64)
    others = table[~np.isnan(table).any(1)] if len(table) else table
    return [
        bool(not np.isnan(point).any() and not ((others <= point).all(1) & (others < point).any(1)).any())
        for point in table
    ]


@dataclass(frozen=True)
class FittedLine:
    """Least-squares line ``start + slope x``, and the largest relative deviation of a point from it."""

    start: float
    slope: float
    worst: float


def line(x: Sequence[float], y: Sequence[float]) -> FittedLine | None:
    """Least-squares line through points weighted by 1 / y, which minimises relative errors.

    None with fewer than three points, which a line fits exactly, or with a y that is not above 0.
    """
    across, up = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(across) < 3 or not (up > 0).all() or np.ptp(across) == 0:
        return None
    design = np.stack([1 / up, across / up], 1)
    start, slope = np.linalg.lstsq(design, np.ones_like(up), rcond=None)[0]
    worst = float(np.abs((start + slope * across) / up - 1).max())
    return FittedLine(float(start), float(slope), worst)
