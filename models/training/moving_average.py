"""The exponential moving average of a network's weights, which is what ships (Polyak and Juditsky 1992)."""

from __future__ import annotations

import torch
from torch import nn

MOST = 0.999
"""Largest share of the average that a step keeps."""


def follow(average: nn.Module, network: nn.Module, step: int, most: float = MOST) -> None:
    """Move the average towards the network, after ``step`` steps before this one; in the beginning it keeps less."""
    decay = min(most, (1.0 + step) / (10.0 + step))
    with torch.no_grad():
        torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), 1.0 - decay)
