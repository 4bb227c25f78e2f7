"""Skin without detail, for tests and comparisons with other renderers."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from models.lightstage.skin.window import ChartWindow


@dataclass(frozen=True)
class PlainSkin:
    """The maps that ``bake`` reads, (C, h, w); see ``SkinMaps``."""

    diffuse_albedo: Tensor
    specular_albedo: Tensor
    roughness: Tensor
    specular_normal: Tensor
    diffuse_normal: Tensor
    height_mm: Tensor
    mask: Tensor

    @classmethod
    def even(
        cls,
        window: ChartWindow,
        albedo: tuple[float, float, float] = (0.6, 0.4, 0.3),
        specular: float = 0.7,
        alpha: tuple[float, float] = (0.3, 0.3),
        share: float = 1.0,
        dtype: torch.dtype = torch.float32,
    ) -> PlainSkin:
        """The same everywhere, smooth."""

        def full(*values: float) -> Tensor:
            return torch.tensor(values, dtype=dtype).view(-1, 1, 1).expand(-1, window.height, window.width).clone()

        up = full(0.0, 0.0, 1.0)
        return cls(full(*albedo), full(specular), full(*alpha, share), up, up, full(0.0), full(1.0))
