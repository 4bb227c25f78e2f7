"""Edges of lids and lips in a patch: some convolutions and two numbers with their scatter at each station."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from models.networks.blocks import activation

STATIONS = 9
LEAST = 0.004
"""Least scatter that the network may claim, over the length of the opening."""
WIDTHS = (16, 32, 64, 96)
NARROW, HIDDEN = 24, 128


class OpeningNetwork(nn.Module):
    """(N, 3, S, S) sRGB in [0, 1] -> heights (N, 2, 9) of upper and lower edge over the length, and their scatter.

    Args:
        side: of the patch, a multiple of 8.
    """

    def __init__(self, side: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        before = 3
        for level, width in enumerate(WIDTHS):
            layers += [_conv(before, width, 1 if level == 0 else 2), _conv(width, width, 1)]
            before = width
        self.trunk = nn.Sequential(*layers, nn.Conv2d(before, NARROW, 1), activation())
        cells = (side // 2 ** (len(WIDTHS) - 1)) ** 2
        self.head = nn.Sequential(
            nn.Flatten(), nn.Linear(NARROW * cells, HIDDEN), activation(), nn.Linear(HIDDEN, 4 * STATIONS)
        )

    def forward(self, patch: Tensor) -> tuple[Tensor, Tensor]:
        """Heights and scatter."""
        out = self.head(self.trunk(patch - 0.5)).view(-1, 4, STATIONS)
        return 0.2 * out[:, :2], cast(Tensor, LEAST + 0.1 * functional.softplus(out[:, 2:]))


def _conv(before: int, width: int, stride: int) -> nn.Module:
    return nn.Sequential(nn.Conv2d(before, width, 3, stride, 1), nn.GroupNorm(8, width), activation())


def loss(heights: Tensor, scatter: Tensor, true: Tensor) -> Tensor:
    """Mean negative log-likelihood of a Laplace distribution."""
    return torch.mean(torch.log(scatter) + (heights - true).abs() / scatter)
