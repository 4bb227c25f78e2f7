"""Charts of one colour each."""

from __future__ import annotations

import torch
from torch import Tensor

from models.networks.context import HEIGHT, WIDTH


def charts(count: int, albedo: float, light: float) -> tuple[Tensor, Tensor]:
    """Texture and albedo."""
    plain = torch.full((count, 3, HEIGHT, WIDTH), albedo)
    return plain * light, plain
