"""Texels of one part of the head on a map, and their positions on the mean head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float64
from service.geometry.chart import chart_points
from service.geometry.raster import rasterise
from service.head.model import HeadModel


@dataclass(frozen=True)
class PartTexels:
    """One part's island on a map.

    Attributes:
        box: its bounding box, slices of the map's rows and columns.
        inside: (h, w) bool, texels of the box that belong to it.
        points: (N, 3) float64 metres on the mean head, of the texels inside.
        vertices: (M, 3) float64 metres, the part's vertices on the mean head.
    """

    box: tuple[slice, slice]
    inside: Bool
    points: Float64
    vertices: Float64

    @classmethod
    def of(cls, head: HeadModel, name: str, size: tuple[int, int]) -> PartTexels | None:
        """On a map of a size (width, height); None where the head has no such part or the map no texel of it."""
        if name not in head.part_names:
            return None
        own = head.triangle_part == head.part_names.index(name)
        corners, at = head.triangles[own], chart_points(head, *size)[head.triangle_uv[own]]
        if not len(corners):
            return None
        low = np.maximum(np.floor(at.min((0, 1))).astype(int), 0)
        high = np.minimum(np.ceil(at.max((0, 1))).astype(int) + 1, size)
        if (high <= low).any():
            return None
        flat = at.reshape(-1, 2) - low
        raster = rasterise(flat, np.zeros(len(flat)), np.arange(len(flat)).reshape(-1, 3), *map(int, high - low))
        inside = raster.mask
        if not inside.any():
            return None
        hit = head.mean[corners[raster.triangle[inside]]].astype(np.float64)
        points = np.einsum("nk,nki->ni", raster.barycentric[inside].astype(np.float64), hit)
        box = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
        return cls(box, inside, points, head.mean[np.unique(corners)].astype(np.float64))
