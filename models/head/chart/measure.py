"""Measures of a chart: size of texels, stretch, flips, overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
WIDTH, HEIGHT = 6144, 4096


@dataclass(frozen=True)
class Measures:
    """Per triangle of the head.

    Attributes:
        area_mm2: (T,) on the mean head.
        signed_px2: (T,) area in the chart at 6144 x 4096, negative where flipped.
        ppm: (T,) texels per mm (geometric mean over directions).
        stretch: (T,) larger over smaller singular value of the map from surface to chart, inf where it is flat.
    """

    area_mm2: Float
    signed_px2: Float
    ppm: Float
    stretch: Float


def measure(head: HeadModel) -> Measures:
    """Measure every triangle of the chart on the mean head (method: singular values of the Jacobian)."""
    corner = head.mean[head.triangles].astype(float) * 1e3
    flat = head.uv[head.triangle_uv].astype(float) * [WIDTH, HEIGHT]
    e1, e2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    d1, d2 = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(e1, e2), axis=1)
    signed = 0.5 * (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])
    # metric of the inverse map (surface to chart): singular values from trace and determinant of J^T J
    first = (e1**2).sum(1), (e1 * e2).sum(1), (e2**2).sum(1)
    second = (d1**2).sum(1), (d1 * d2).sum(1), (d2**2).sum(1)
    det = np.maximum(4 * area**2, 1e-18)
    trace = (second[0] * first[2] - 2 * second[1] * first[1] + second[2] * first[0]) / det
    ratio = np.abs(2 * signed) / np.sqrt(det)  # product of the singular values
    root = np.sqrt(np.maximum(trace**2 / 4 - ratio**2, 0))
    large, small = trace / 2 + root, np.maximum(trace / 2 - root, 0)
    with np.errstate(divide="ignore"):
        stretch = np.sqrt(large / small)
    return Measures(area, signed, np.sqrt(ratio), stretch)


def overlap_texels(head: HeadModel, width: int = 3072) -> int:
    """Texel centres of the chart at a width that lie well inside more than one triangle."""
    height = width * HEIGHT // WIDTH
    count = np.zeros((height, width), np.int16)
    flat = head.uv[head.triangle_uv].astype(float) * [width, height]
    for corners in flat:
        low = [max(int(v), 0) for v in np.floor(corners.min(0) - 0.5)]
        high = [min(int(v) + 1, top) for v, top in zip(np.ceil(corners.max(0)), (width, height), strict=True)]
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        inside = np.ones(x.shape, bool)
        for k in range(3):
            a, b = corners[k], corners[(k + 1) % 3]
            side = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            inside &= side > 1e-3 * np.hypot(*(b - a))
        count[low[1] : high[1], low[0] : high[0]] += inside
    return int((count > 1).sum())


def percentiles(value: Float, weight: Float, shares: tuple[float, ...]) -> list[float]:
    """Weighted percentiles (shares in [0, 1]); NaN where there is no weight."""
    if weight.sum() <= 0:
        return [float("nan")] * len(shares)
    value, weight = value[weight > 0], weight[weight > 0]
    order = np.argsort(value)
    running = np.cumsum(weight[order]) / weight.sum()
    place = np.minimum(np.searchsorted(running, shares), len(order) - 1)
    return [float(x) for x in value[order][place]]
