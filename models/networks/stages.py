"""The networks by their task: what goes in, what comes out, and in which units (AvatarMe, section 4.2 to 4.4)."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn

from models.colour import linear, srgb
from models.networks.blocks import inside, rounded_up
from models.networks.coarse_to_fine import CoarseToFine, CoarseToFineSize
from models.networks.context import DARKEST
from models.networks.translator import Translator, TranslatorSize
from service.colour import LUMA
from service.runtime.network_registry import CONTEXT, DEPTH, FINE, FINE_GAIN, FINE_WINDOW, MASK, REGISTRY, TEXTURE


def planes_of(name: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the planes that a network is made for, without what is found from them, and of those that it gives.

    Raises:
        StopIteration: there is no network of that name.
    """
    row = next(one for one in REGISTRY if one.name == name)
    return tuple(channel for channel in row.channels if channel not in FINE), row.outputs


STEEPEST = 3.0
"""Largest slope of a predicted normal along each axis: 72 degrees."""


def detail_of(grey: Tensor) -> Tensor:
    """(N, 1, H, W) difference from the mean of the neighbourhood; columns first, then rows, which is far fewer sums."""
    half = FINE_WINDOW // 2
    mean = nn.functional.avg_pool2d(grey, (FINE_WINDOW, 1), stride=1, padding=(half, 0), count_include_pad=False)
    mean = nn.functional.avg_pool2d(mean, (1, FINE_WINDOW), stride=1, padding=(0, half), count_include_pad=False)
    return grey - mean


BodySize = TranslatorSize | CoarseToFineSize


def _body(detail: int, slow: int, out: int, size: BodySize, whole: int) -> Translator | CoarseToFine:
    if isinstance(size, TranslatorSize):
        return Translator(detail, slow, out, size, whole)
    return CoarseToFine(detail + slow, out, size)


class StageNet(nn.Module):
    """A body between named channels.

    In the service it is given the enlarged detail before its other channels (``prepared``), and what it says is not
    ``finished``: both are faster beside the network than in it.

    Attributes:
        channels: names of the input channels in order; values as in ``service`` (all about [-1, 1]).
        outputs: names of the output channels.
        detail: how many of the first channels carry detail of single texels.
        whole: how many after these, though slow, are wanted at all texels.
        grey: share of each of the first channels in the grey whose enlarged detail the body gets too; empty for none.
        margin: input pixels at each side that the result in the service is without, a multiple of the stride; None
            where it is trained.
    """

    channels: tuple[str, ...]
    outputs: tuple[str, ...]
    detail: int
    grey: tuple[float, ...] = ()
    whole = 0
    margin: int | None = None

    def __init__(self, size: BodySize, out: int) -> None:
        super().__init__()
        added = 1 if self.grey else 0
        self.body = _body(self.detail + added, len(self.channels) - self.detail, out, size, self.whole)
        self.reach = FINE_WINDOW // 2 if added else 0
        shares = torch.zeros(1, len(self.channels), 1, 1)
        shares[0, : len(self.grey), 0, 0] = torch.tensor(self.grey)
        self.register_buffer("shares", shares * FINE_GAIN, persistent=False)

    def prepared(self, x: Tensor) -> Tensor:
        """What the body takes of the channels (N, C, H, W): their enlarged detail first, where it is wanted, and slow
        ones packed.
        """
        if self.grey:
            x = torch.cat([detail_of(nn.functional.conv2d(x, cast(Tensor, self.shares))), x], 1)
        return self.body.stem.packed(x) if isinstance(self.body, Translator) else x

    def said(self, x: Tensor) -> Tensor:
        """What a network makes of its ``prepared`` channels."""
        raise NotImplementedError

    def finished(self, said: Tensor) -> Tensor:
        """The outputs of the trained network."""
        return said

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, K, H, W); in the service, without a margin, of ``prepared`` channels what is ``said``."""
        return self.finished(self.said(self.prepared(x))) if self.margin is None else self.said(x)

    def looked_at(self, x: Tensor) -> Tensor:
        """What the body makes of its ``prepared`` channels -> (N, out, H, W) without the margin."""
        return cast(Tensor, self.body(x, self.margin or 0))

    @property
    def stride(self) -> int:
        """Sides of the input have to be multiples of it."""
        return self.body.size.stride

    def halo(self) -> int:
        """Input pixels beyond which nothing matters."""
        return rounded_up(self.body.halo() + self.reach, self.stride)


class Delta(StageNet):
    """delta: baked texture, geometry and the context's log light -> diffuse albedo, sRGB-coded in [-1, 1].

    The network predicts what the context's estimate of log(texture / albedo) leaves open. Where it is unsure it can
    leave the texture as it is.
    """

    channels, outputs = planes_of("delta")
    detail = 3
    whole = 3

    def __init__(self, size: BodySize) -> None:
        super().__init__(size, 3)

    def said(self, x: Tensor) -> Tensor:
        """Texture, context and packed geometry (N, 8, H, W) -> (N, 3, H, W)."""
        own = inside(x, self.margin or 0)
        light = own[:, 3:6] + self.looked_at(x)
        texture = linear(own[:, :3] * 0.5 + 0.5).clamp(min=DARKEST)
        return srgb(texture * torch.exp(-light.clamp(-4.0, 4.0))) * 2.0 - 1.0


class DeltaBlind(Delta):
    """delta from colour and depth alone, as in the paper's first variant."""

    channels = (*TEXTURE, *CONTEXT, *DEPTH, *MASK)


class Psi(StageNet):
    """psi: diffuse albedo -> specular albedo in [-1, 1] (0 and F0 = 0.04 at the ends)."""

    channels, outputs = planes_of("psi")
    detail = 3
    grey = tuple(float(share) for share in LUMA)

    def __init__(self, size: BodySize) -> None:
        super().__init__(size, 1)

    def said(self, x: Tensor) -> Tensor:
        """(N, 5, H, W) -> (N, 1, H, W)."""
        return torch.tanh(self.looked_at(x))


class NormalNet(StageNet):
    """Predicts slopes, so that every output is a unit normal that faces outwards; in the service, the slopes."""

    detail = 1
    grey = (1.0,)

    def __init__(self, size: BodySize) -> None:
        super().__init__(size, 2)

    def said(self, x: Tensor) -> Tensor:
        """(N, 4, H, W) -> (N, 2, H, W) x and y over z of normals in the mesh's tangent space, +Y up."""
        return STEEPEST * torch.tanh(self.looked_at(x) / STEEPEST)

    def finished(self, said: Tensor) -> Tensor:
        """(N, 2, H, W) -> (N, 3, H, W) unit normals."""
        length = torch.rsqrt(said.square().sum(1, keepdim=True) + 1.0)
        return torch.cat([said * length, length], 1)


class Rho(NormalNet):
    """rho: grey albedo with its fine shade, tangent shape normals and who drew the detail -> specular normals."""

    channels, outputs = planes_of("rho")


class Sigma(NormalNet):
    """sigma: the same with object-space shape normals -> diffuse normals."""

    channels, outputs = planes_of("sigma")
