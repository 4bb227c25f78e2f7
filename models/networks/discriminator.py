"""Multi-scale patch discriminator with feature matching (pix2pixHD, section 3.2), with spectral norm for batch norm."""

from __future__ import annotations

import itertools
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils.parametrizations import spectral_norm

from models.networks.blocks import activation

Features = list[Tensor]


class PatchDiscriminator(nn.Module):
    """Judges overlapping patches of 70 pixels; keeps its features for matching."""

    def __init__(self, channels: int, width: int, layers: int = 3) -> None:
        super().__init__()
        widths = [channels, *(min(width * 2**i, width * 8) for i in range(layers))]
        stages = [
            nn.Sequential(spectral_norm(nn.Conv2d(a, b, 4, stride=2, padding=1)), activation())
            for a, b in itertools.pairwise(widths)
        ]
        last = nn.Sequential(spectral_norm(nn.Conv2d(widths[-1], widths[-1], 3, padding=1)), activation())
        self.stages = nn.ModuleList([*stages, last, spectral_norm(nn.Conv2d(widths[-1], 1, 3, padding=1))])

    def forward(self, x: Tensor) -> Features:
        """(N, C, h, w) -> features of each layer; the last has one channel, the judgement."""
        result = []
        for stage in self.stages:
            x = stage(x)
            result.append(x)
        return result


class Discriminator(nn.Module):
    """The same at several scales."""

    def __init__(self, channels: int, width: int = 32, scales: int = 2, layers: int = 3) -> None:
        super().__init__()
        self.scales = nn.ModuleList(PatchDiscriminator(channels, width, layers) for _ in range(scales))

    def forward(self, x: Tensor) -> list[Features]:
        """(N, C, h, w) -> features by scale and layer; each scale has half the resolution of the one before."""
        result = []
        for i, scale in enumerate(self.scales):
            if i:
                x = nn.functional.avg_pool2d(x, 3, stride=2, padding=1, count_include_pad=False)
            result.append(scale(x))
        return result


def judge_loss(real: list[Features], fake: list[Features]) -> Tensor:
    """What the discriminator minimises: hinge, mean over scales."""
    parts = [torch.relu(1.0 - r[-1]).mean() + torch.relu(1.0 + f[-1]).mean() for r, f in zip(real, fake, strict=True)]
    return torch.stack(parts).mean()


def fool_loss(fake: list[Features]) -> Tensor:
    """What the generator minimises to be taken for real: hinge, mean over scales."""
    return torch.stack([-f[-1].mean() for f in fake]).mean()


def matching_loss(real: list[Features], fake: list[Features]) -> Tensor:
    """Mean L1 distance of features, those of the real image held fixed (pix2pixHD, eq. 4)."""
    pairs = [(r, f) for rs, fs in zip(real, fake, strict=True) for r, f in zip(rs[:-1], fs[:-1], strict=True)]
    return cast(Tensor, sum((f - r.detach()).abs().mean() for r, f in pairs) / max(len(pairs), 1))
