"""A rectangle of the chart at some resolution."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from service.errors import UsageError

CHART_WIDTH = 6144
CHART_HEIGHT = 4096


@dataclass(frozen=True)
class ChartWindow:
    """Columns x .. x + width - 1 and rows y .. y + height - 1 of a chart of ``chart_width`` x ``chart_height`` texels.

    Texel (row r, column c) has its centre at u = (c + 0.5) / chart_width, v = 1 - (r + 0.5) / chart_height. A window
    may reach beyond the chart (halos do).
    """

    x: int
    y: int
    width: int
    height: int
    chart_width: int = CHART_WIDTH
    chart_height: int = CHART_HEIGHT

    def __post_init__(self) -> None:
        """Refuse windows without texels."""
        if min(self.width, self.height, self.chart_width, self.chart_height) < 1:
            raise UsageError(
                f"a chart window of {self.width}x{self.height} in {self.chart_width}x{self.chart_height} is empty"
            )

    @classmethod
    def whole(cls, chart_width: int = CHART_WIDTH, chart_height: int = CHART_HEIGHT) -> ChartWindow:
        """The whole chart."""
        return cls(0, 0, chart_width, chart_height, chart_width, chart_height)

    def grown(self, halo: int, multiple: int = 1) -> ChartWindow:
        """At least ``halo`` texels more on each side, corners moved out to multiples of ``multiple``."""
        left, top = (self.x - halo) // multiple * multiple, (self.y - halo) // multiple * multiple
        right = -((-(self.x + self.width + halo)) // multiple) * multiple
        bottom = -((-(self.y + self.height + halo)) // multiple) * multiple
        return ChartWindow(left, top, right - left, bottom - top, self.chart_width, self.chart_height)

    def cut(self, image: Tensor, outer: ChartWindow) -> Tensor:
        """The part of ``image`` (..., h, w), which shows ``outer``, that this window shows."""
        row, column = self.y - outer.y, self.x - outer.x
        return image[..., row : row + self.height, column : column + self.width]

    def columns(self, count: int) -> Tensor:
        """(width,) float64 positions of the texel centres on a map of ``count`` texels, whose centres are integers."""
        centre = torch.arange(self.x, self.x + self.width, dtype=torch.float64) + 0.5
        return centre * (count / self.chart_width) - 0.5

    def rows(self, count: int) -> Tensor:
        """(height,) float64, as ``columns``."""
        centre = torch.arange(self.y, self.y + self.height, dtype=torch.float64) + 0.5
        return centre * (count / self.chart_height) - 0.5
