"""Loss of a map against another, and the Pareto front of cost against loss.

Maps of different sizes are compared at both sizes: at the smaller one, for uses that need no more resolution, and at
the larger one, which counts the missing detail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from service.arrays import Bool, Float32, Float64, UInt8
from service.reflectance.reflectance_maps import unpack_normals

Kind = Literal["colour", "normal", "height"]

UNITS: dict[Kind, str] = {"colour": "dB", "normal": "°", "height": "µm"}
"""Unit of :meth:`Loss.shown`."""

SAME_DB = 99.0
"""PSNR reported for identical maps."""


@dataclass(frozen=True)
class Loss:
    """Distance from the reference.

    Attributes:
        kind: of the maps.
        at_own: at the size of the map: root mean square in [0, 1] of coded colours, mean degrees
            of normals, root mean square in micrometres of heights.
        at_full: the same at the size of the reference.
    """

    kind: Kind
    at_own: float
    at_full: float

    def shown(self, error: float) -> float:
        """The error in ``UNITS``: decibels for colours, else unchanged."""
        return decibels(error) if self.kind == "colour" else error


def decibels(rms: float) -> float:
    """PSNR of a root mean square error of values in [0, 1], at most ``SAME_DB``."""
    return min(-20 * float(np.log10(max(rms, 1e-12))), SAME_DB)


def compare(kind: Kind, found: npt.NDArray[Any], reference: npt.NDArray[Any], mask: UInt8) -> Loss:
    """Loss of a map.

    Args:
        kind: "colour": uint16 codes, 65535 = 1. "normal": (h, w, 2) int16 codes. "height": (h, w) float32 mm.
        found: (h, w, ...).
        reference: (H, W, ...) of the same part of the chart.
        mask: (H, W) uint8, above 0 where texels are compared; if it is empty, all are.
    """
    one, other = _values(kind, found), _values(kind, reference)
    errors = []
    for size in (found.shape[1::-1], reference.shape[1::-1]):
        counts = _resized(np.asarray(mask, np.float32), size) > 0
        errors.append(_error(kind, _sized(kind, one, size), _sized(kind, other, size), counts))
    return Loss(kind, *errors)


def _values(kind: Kind, codes: npt.NDArray[Any]) -> Float32:
    if kind == "normal":
        return unpack_normals(codes)
    # OpenCV drops an axis of length 1; comparing maps with and without it would broadcast.
    plain = codes[..., 0] if codes.ndim == 3 and codes.shape[2] == 1 else codes
    return np.asarray(plain, np.float32) * np.float32(1 / 65535 if kind == "colour" else 1)


def _error(kind: Kind, found: Float32, reference: Float32, counts: Bool) -> float:
    chosen = counts if counts.any() else np.ones_like(counts)
    if kind == "normal":
        return float(degrees(found[chosen], reference[chosen]).mean())
    rms = float(np.sqrt(np.square(found[chosen] - reference[chosen], dtype=np.float64).mean()))
    return 1000 * rms if kind == "height" else rms


def degrees(found: Float32, reference: Float32) -> Float64:
    """(...) angles between vectors (..., 3) of any length; 0 where one is zero. Accurate for small angles."""
    one, other = (np.asarray(vectors, np.float64) for vectors in (found, reference))
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("...i,...i->...", one, other))))


def _sized(kind: Kind, values: Float32, size: tuple[int, int]) -> Float32:
    if values.shape[1::-1] == size:
        return values
    result = _resized(values, size)
    if kind != "normal":
        return result
    length = np.sqrt(np.einsum("yxi,yxi->yx", result, result))[..., None]
    return np.asarray(
        np.where(length > 1e-3, result / np.maximum(length, 1e-3), np.array([0, 0, 1], np.float32)), np.float32
    )


def _resized(values: Float32, size: tuple[int, int]) -> Float32:
    import cv2

    way = cv2.INTER_AREA if size[0] <= values.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(values, size, interpolation=way), np.float32)


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
