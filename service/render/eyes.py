"""Visibility at the eyes on a finer chart: the eye between its lids is narrower than a texel of the coarse one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Int64
from service.geometry.chart import Chart
from service.geometry.points import surface_points

Size = tuple[int, int]

REACH_MM = 40.0
"""Distance from an eye's centre up to which geometry casts shadows on it; brows, nose and lids lie within."""


@dataclass(frozen=True)
class Eyes:
    """Eyes and the geometry around them.

    Attributes:
        chart: on which they are lit.
        index: (n,) of their texels among the chart's inner ``texels``.
        occluders: (3, M) mm.
        spacing_mm: of the occluders.
    """

    chart: Chart
    index: Int64
    occluders: Float32
    spacing_mm: float

    @classmethod
    def of(
        cls,
        chart: Chart,
        vertices: AnyFloat,
        casts: Bool,
        spacing: float,
    ) -> Eyes | None:
        """The eyes of a head; None where it has none, or the chart is so coarse that they have no texel.

        Args:
            chart: of the head, on which they are to be lit.
            vertices: (V, 3) metres.
            casts: (T,) triangles that cast shadows.
            spacing: of the points that cast shadows, mm.
        """
        head = chart.head
        parts = [index for index, name in enumerate(head.part_names) if name.startswith("eye")]
        index = np.flatnonzero(np.isin(chart.inner_part, parts))
        if not len(index):
            return None
        millimetres = np.asarray(vertices, np.float64) * 1000.0
        near = np.zeros(len(millimetres), bool)
        for part in parts:
            eye = millimetres[np.unique(head.triangles[head.triangle_part == part])]
            if len(eye):
                near |= np.linalg.norm(millimetres - eye.mean(0), axis=1) < REACH_MM
        cloud = surface_points(millimetres, head.triangles[casts & near[head.triangles].any(1)], spacing)
        return cls(chart, index, np.ascontiguousarray(cloud.T), spacing)

    def over(self, image: Float32, values: Float32) -> Float32:
        """(H, W, C) image of the whole chart with its eyes replaced by values (n, C)."""
        stacked = np.zeros((len(self.chart.texels), values.shape[1] + 1), np.float32)
        stacked[self.index] = np.c_[values, np.ones(len(self.index), np.float32)]
        there = resized(self.chart.spread(stacked), (image.shape[1], image.shape[0]))
        share = there[..., -1:]
        return np.where(share > 0.5, there[..., :-1] / np.maximum(share, 0.5), image).astype(np.float32)


def resized(image: Float32, size: Size) -> Float32:
    """(H, W, C) bilinear values of an image (h, w, C), of any number of channels, at ``size`` (width, height)."""
    import cv2

    return np.stack(
        [np.asarray(cv2.resize(plane, size)) for plane in np.ascontiguousarray(np.moveaxis(image, 2, 0))], -1
    )
