"""What the networks know of a head's shape: slow maps, made once at 768 x 512 and enlarged into each tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.head.model import HeadModel
from service.texture.shape import depth_map, shape_normals

WIDTH, HEIGHT = 768, 512
REACH_MM = 128.0
"""Half the extent of a head: depth and position are divided by it."""

CHANNELS = (
    "depth",
    *(f"normal_object_{axis}" for axis in "xyz"),
    *(f"normal_tangent_{axis}" for axis in "xyz"),
    *(f"position_{axis}" for axis in "xyz"),
    "mask",
)

Float = npt.NDArray[np.float32]


@dataclass(frozen=True)
class GeometryMaps:
    """Makes the geometry channels of heads of one topology."""

    chart: Chart
    position: Float

    @classmethod
    def of(cls, head: HeadModel) -> GeometryMaps:
        """Rasterise the chart, once for all heads of one topology."""
        chart = Chart.build(head, WIDTH, HEIGHT)
        rest = chart.fill_outside(chart.interpolate(head.mean.astype(np.float64) * 1000.0))
        return cls(chart, (rest / REACH_MM).astype(np.float32))

    def channels(self, vertices: npt.NDArray[np.floating]) -> Float:
        """(11, 512, 768) float32 in the order of ``CHANNELS``, continued beyond the islands.

        Args:
            vertices: (V, 3) metres in head space.
        """
        exact, tangent = shape_normals(self.chart, vertices)
        depth = depth_map(self.chart, vertices)[..., None] * (1000.0 / REACH_MM)
        mask = self.chart.mask[..., None].astype(np.float32)
        stacked = np.concatenate([depth, exact, tangent, self.position, mask], -1)
        return np.ascontiguousarray(stacked.transpose(2, 0, 1), np.float32)
