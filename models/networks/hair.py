"""What a photo shows of hair: where, which way its strands run, and what kind it is.

The body is built as the reader's (``models.networks.reader``), only broader; a run of the reader's own size begins with
its weights, as these know faces and hair already. Into it goes a wider crop of the head, out of it come, for each cell
of two by two pixels, hair and direction, and for the whole the logarithms of the kinds' probabilities and the height of
the lowest ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from models.networks.blocks import activation
from models.networks.reader import Reader, ReaderSize
from service.face.reading import part_labels as labels
from service.hair.kinds import KINDS

SIDE, CELL = 224, 2
"""Pixels along the crop, and along a cell."""
COUNTS = tuple(len(names) for names in KINDS.values())
"""Choices of each kind, which lie one after the other in the output."""
LEAST_WAY = 0.05
"""Length from which on a direction is made a unit vector: shorter ones would be rounding errors, enlarged."""
LEAST_SPREAD, LEAST_ENDS_M = 0.05, 0.006
"""Standard deviations that the network may claim at best: of a component of the direction, and of the ends' height."""
USUAL_ENDS_M, ENDS_UNIT_M = -0.12, 0.1
SIZES = {"compact": ReaderSize(), "broad": ReaderSize((32, 56, 88, 128, 160), (0, 2, 2, 2, 3), 2)}
"""Named sizes: 1.2 and 3.6 GFLOP a crop; the broad one ships."""
WHOLE = (24, 96)
"""Channels of the coarsest cells, and of the whole, from which the kinds are told."""


@dataclass(frozen=True)
class ReadHair:
    """What the network says of N crops.

    Attributes:
        mask: (N, 1, 112, 112) logit of the share of hair.
        direction: (N, 2, 112, 112) unit (shorter where there is none), x right, y down, root to tip; spread:
            (N, 1, 112, 112) standard deviation of its components.
        kinds: (N, sum(COUNTS)) logits of the choices of ``service.hair.kinds.KINDS``.
        ends: (N, 2) height of the lowest ends in the head's frame and its standard deviation, metres.
    """

    mask: Tensor
    direction: Tensor
    spread: Tensor
    kinds: Tensor
    ends: Tensor


class HairReader(nn.Module):
    """The network; ``forward`` gives plain tensors for the export, ``read`` the same by name."""

    def __init__(self, size: ReaderSize | None = None) -> None:
        super().__init__()
        self.body = Reader(size)
        widths = self.body.size.widths
        self.cells = nn.Sequential(nn.Conv2d(widths[1], 4 * 4, 1), nn.PixelShuffle(2))
        side = SIDE // 32
        self.squeeze = nn.Conv2d(widths[-1], WHOLE[0], 1)
        self.act = activation()
        self.whole = nn.Linear(WHOLE[0] * side * side + 2 * widths[-1], WHOLE[1])
        self.kinds = nn.Linear(WHOLE[1], sum(COUNTS) + 2)
        nn.init.zeros_(self.kinds.weight)
        self.register_buffer("sharpness", torch.ones(len(COUNTS)))

    def begin_with(self, reader: dict[str, Tensor]) -> None:
        """Take the reader's weights; the mask begins as hair against skin, background and cloth."""
        self.body.load_state_dict(reader)
        conv, parts = cast(nn.Conv2d, self.cells[0]), cast(nn.Conv2d, self.body.parts[0])
        others = [labels.SKIN, labels.BACKGROUND, labels.CLOTH, labels.HAT]
        with torch.no_grad():
            for name in ("weight", "bias"):
                values = getattr(parts, name).view(-1, 4, *getattr(parts, name).shape[1:])
                getattr(conv, name)[:4] = values[labels.HAIR] - values[others].mean(0)

    def forward(self, crop: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """(N, 3, 224, 224) sRGB in [0, 1] -> the fields of ``ReadHair`` in their order."""
        deep, places = self.body.features(crop)
        cells = self.cells(places).float()
        way = cells[:, 1:3]
        direction = way / (way.square().sum(1, keepdim=True) + LEAST_WAY**2).sqrt()
        spread = LEAST_SPREAD + functional.softplus(cells[:, 3:4])
        pooled = [self.act(self.squeeze(deep)).flatten(1), deep.mean((2, 3)), deep.amax((2, 3))]
        told = self.kinds(self.act(self.whole(torch.cat(pooled, 1)))).float()
        logits = torch.cat([
            part * k for part, k in zip(told[:, :-2].split(COUNTS, 1), self.sharpness, strict=True)
        ], 1)  # fmt: skip
        height = USUAL_ENDS_M + ENDS_UNIT_M * told[:, -2:-1]
        ends = torch.cat([height, LEAST_ENDS_M + ENDS_UNIT_M * functional.softplus(told[:, -1:] - 1.0)], 1)
        return cells[:, :1], direction, spread, logits, ends

    def read(self, crop: Tensor) -> ReadHair:
        """``forward`` by name."""
        return ReadHair(*self(crop))
