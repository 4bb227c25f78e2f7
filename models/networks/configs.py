"""Named sizes: ``slim`` and ``compact`` for CPUs, ``wide`` to train on an accelerator, ``paper`` is AvatarMe's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import nn

from models.networks.coarse_to_fine import CoarseToFineSize
from models.networks.context import ContextNet, ContextSize
from models.networks.rcan import RcanBody, RcanSize, RcanTail, with_detail
from models.networks.stages import BodySize, Delta, DeltaBlind, Psi, Rho, Sigma, planes_of
from models.networks.translator import TranslatorSize
from service.errors import UsageError

NETWORKS = ("zeta", "delta_context", "delta", "delta_blind", "psi", "rho", "sigma")
CONTEXT_CHANNELS, _ = planes_of("delta_context")
ZETA_CHANNELS, _ = planes_of("zeta_body")


class Zeta(nn.Module):
    """Body and tail together, as they are trained."""

    channels = ZETA_CHANNELS

    def __init__(self, size: RcanSize) -> None:
        super().__init__()
        self.size = size
        self.body = RcanBody(len(ZETA_CHANNELS), size)
        self.tail = RcanTail(size)

    def forward(self, x: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """(N, 7, h, w) and (N, size.noise, h, w) -> (N, 3, 8h, 8w)."""
        return with_detail(x[:, :3], self.tail(torch.cat([self.body(x), noise], 1)))


@dataclass(frozen=True)
class Config:
    """Sizes of all networks of a family."""

    zeta: RcanSize
    context: ContextSize
    delta: BodySize
    psi: BodySize
    rho: BodySize
    sigma: BodySize


_PIX2PIX_HD = CoarseToFineSize()

CONFIGS = {
    "slim": Config(
        RcanSize(2, 4, 24, tail=(24, 12), noise=8), ContextSize((16, 32, 48, 64), (1, 1, 1, 2)),
        TranslatorSize((12, 24, 48), (1, 1, 2)), TranslatorSize((8, 16, 32), (1, 1, 1)),
        TranslatorSize((12, 24, 48), (1, 1, 2)), TranslatorSize((8, 16, 32), (1, 1, 1)),
    ),
    "compact": Config(
        RcanSize(3, 4, 32, tail=(32, 16), noise=8), ContextSize((32, 56, 88, 128), (1, 1, 2, 3)),
        TranslatorSize((16, 40, 80), (1, 2, 3)), TranslatorSize((12, 24, 48), (1, 1, 2)),
        TranslatorSize((16, 40, 80), (1, 2, 3)), TranslatorSize((12, 24, 48), (1, 1, 2)),
    ),
    "wide": Config(
        RcanSize(5, 10, 64, tail=(64, 32), noise=8), ContextSize((64, 96, 128, 192), (2, 2, 2, 3)),
        TranslatorSize((48, 96, 192), (1, 2, 6)), TranslatorSize((32, 64, 128), (1, 2, 6)),
        TranslatorSize((48, 96, 192), (1, 2, 6)), TranslatorSize((32, 64, 128), (1, 2, 6)),
    ),
    "paper": Config(
        RcanSize(10, 20, 64, tail=(64, 64)), ContextSize((64, 96, 128, 192), (2, 2, 2, 3)),
        _PIX2PIX_HD, _PIX2PIX_HD, _PIX2PIX_HD, _PIX2PIX_HD,
    ),
}  # fmt: skip


def build(network: str, config: str = "compact") -> nn.Module:
    """A fresh network.

    Raises:
        UsageError: no network or configuration has that name.
    """
    if config not in CONFIGS:
        raise UsageError(f"config is {config!r}; there are {', '.join(CONFIGS)}")
    sizes = CONFIGS[config]
    makers: dict[str, Callable[[], nn.Module]] = {
        "zeta": lambda: Zeta(sizes.zeta),
        "delta_context": lambda: ContextNet(len(CONTEXT_CHANNELS), sizes.context),
        "delta": lambda: Delta(sizes.delta),
        "delta_blind": lambda: DeltaBlind(sizes.delta),
        "psi": lambda: Psi(sizes.psi),
        "rho": lambda: Rho(sizes.rho),
        "sigma": lambda: Sigma(sizes.sigma),
    }
    if network not in makers:
        raise UsageError(f"network is {network!r}; there are {', '.join(NETWORKS)}")
    return makers[network]()


def parameters(network: nn.Module) -> int:
    """How many numbers a network has learned."""
    return sum(p.numel() for p in network.parameters())
