"""Where the regions of the head lie on the chart that delta's context sees."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from models.networks.context import HEIGHT, WIDTH
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask


@lru_cache(maxsize=1)
def context_chart() -> Chart:
    """The shipped head's chart at the context's size; built once a process."""
    return Chart.build(load_head(None), WIDTH, HEIGHT)


def region_planes(*groups: tuple[str, ...]) -> Tensor:
    """(len(groups), h, w) float32 in [0, 1]: how much of each group of regions a texel is; 0 outside the islands."""
    chart = context_chart()
    values = chart.interpolate(np.stack([vertex_mask(chart.head, *names) for names in groups], 1))
    planes = np.moveaxis(values * chart.mask[..., None], 2, 0)
    return torch.as_tensor(np.ascontiguousarray(planes, np.float32))
