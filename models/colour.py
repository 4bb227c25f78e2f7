"""sRGB coding of tensors (IEC 61966-2-1). Powers are written as exponentials, which runtimes compute far faster."""

from __future__ import annotations

import torch
from torch import Tensor


def srgb(linear: Tensor) -> Tensor:
    """sRGB-coded values of linear ones, cut to [0, 1]."""
    x = linear.clamp(0.0, 1.0)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * torch.exp(torch.log(x.clamp(min=0.0031308)) / 2.4) - 0.055)


def linear(coded: Tensor) -> Tensor:
    """Linear values of sRGB-coded ones, cut to [0, 1]."""
    x = coded.clamp(0.0, 1.0)
    return torch.where(x <= 0.04045, x / 12.92, torch.exp(2.4 * torch.log((x.clamp(min=0.04045) + 0.055) / 1.055)))
