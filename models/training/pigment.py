"""Pigment that follows no region: vitiligo, birthmarks, melasma, flushed skin, freckles, and the edges of a tan.

The light stage draws freckles and moles of its own, and nothing larger. What a network has never seen as pigment it
takes for shade or for light: a pale patch becomes a highlight, the edge of a tan the shadow of a brim.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from models.networks.context import HEIGHT, WIDTH
from models.training.degrade import blur, smooth_field
from models.training.regions import region_planes
from models.training.tasks import choice, one, uniform

OFTEN = 0.12
"""Share of the charts that have each kind."""

MELANIN, BLOOD = (0.85, 1.0, 1.15), (0.15, 1.0, 0.75)
"""Absorption by channel over that in green, of more or less melanin and of more blood."""

CHART = (HEIGHT, WIDTH)


def islands(
    shape: tuple[int, int], cells: int, edge: tuple[float, float], sharp: float, generator: torch.Generator
) -> Tensor:
    """(h, w) in [0, 1]: where a random field with ``cells`` waves is above a random ``edge``, standard deviations."""
    field = smooth_field((1, 1, *shape), cells, generator)[0, 0]
    return ((field - uniform(generator, *edge, 1)) * sharp + 0.5).clamp(0.0, 1.0)


def dots(often: Tensor, size: float, generator: torch.Generator) -> Tensor:
    """(h, w) round dots whose middles lie at a texel as ``often`` (h, w) says; 1 and more where they are densest."""
    middles = (torch.rand(often.shape, generator=generator) < often).float()
    return blur(middles[None, None], size)[0, 0]


class Pigment:
    """Draws patches; knows where the face, its middle and the eyes are."""

    def __init__(self) -> None:
        self.face, self.middle, eyes = region_planes(
            ("face",), ("cheek_left", "cheek_right", "nose", "chin"), ("eyelid_left", "eyelid_right")
        )
        self.middle = blur(self.middle[None, None], 3.0)[0, 0]
        around = blur(eyes[None, None], 6.0)[0, 0]
        self.eyes = around / around.amax().clamp(min=1e-6)
        rows = (self.face.amax(1) > 0.5).nonzero().float()
        self.rows = (float(rows.min()), float(rows.max())) if len(rows) else (0.0, float(HEIGHT))

    def density(self, count: int, generator: torch.Generator) -> Tensor:
        """(N, 3, h, w) -log of what the patches leave of the albedo; below 0 the skin is paler than it was."""
        kinds: tuple[tuple[Callable[[torch.Generator], Tensor], tuple[float, float], tuple[float, float, float]], ...]
        kinds = (
            (self._vitiligo, (-1.0, -0.2), MELANIN), (self._melasma, (0.1, 0.5), MELANIN),
            (self._birthmark, (0.15, 0.9), MELANIN), (self._birthmark, (0.15, 0.9), BLOOD),
            (self._flush, (0.05, 0.6), BLOOD), (self._tan, (-0.4, 0.4), MELANIN), (self._freckles, (0.1, 0.7), MELANIN),
        )  # fmt: skip
        logs = torch.zeros(count, 3, HEIGHT, WIDTH)
        for where, depth, colour in kinds:
            for i in (torch.rand(count, generator=generator) < OFTEN).nonzero().flatten().tolist():
                tint = torch.tensor(colour) * torch.exp(0.1 * torch.randn(3, generator=generator))
                logs[i] += where(generator) * uniform(generator, *depth, 1) * tint.view(3, 1, 1)
        return logs

    def _vitiligo(self, generator: torch.Generator) -> Tensor:
        patch = islands(CHART, (8, 12, 20)[choice(generator, 3)], (0.7, 1.7), one(generator, 3.0, 12.0), generator)
        return torch.maximum(patch, patch.flip(-1)) if choice(generator, 2) else patch  # as often as not on both sides

    def _melasma(self, generator: torch.Generator) -> Tensor:
        patch = islands(CHART, (12, 20)[choice(generator, 2)], (0.2, 1.2), 2.0, generator) * self.face
        return torch.maximum(patch, patch.flip(-1))

    def _birthmark(self, generator: torch.Generator) -> Tensor:
        return islands(CHART, (5, 8, 12)[choice(generator, 3)], (1.4, 2.2), one(generator, 3.0, 15.0), generator)

    def _flush(self, generator: torch.Generator) -> Tensor:
        return self.middle * islands(CHART, (12, 24, 48)[choice(generator, 3)], (-1.5, 0.3), 1.0, generator)

    def _tan(self, generator: torch.Generator) -> Tensor:
        """What a cap, a collar or glasses kept from the sun, or all but that."""
        kind, soft = choice(generator, 3), one(generator, 0.7, 5.0)
        if kind == 2:
            return ((self.eyes - uniform(generator, 0.2, 0.6, 1)) * 8.0 / soft + 0.5).clamp(0.0, 1.0)
        top, bottom = self.rows
        line = top + (bottom - top) * uniform(generator, *((0.05, 0.3) if kind == 0 else (0.85, 1.1)), 1)
        line = line + 4.0 * smooth_field((1, 1, 1, WIDTH), 4, generator)[0, 0]
        below = torch.sigmoid((torch.arange(HEIGHT).view(-1, 1) - line) / soft)
        return 1.0 - below if kind == 0 else below

    def _freckles(self, generator: torch.Generator) -> Tensor:
        often = uniform(generator, 0.01, 0.1, 1) * (0.3 + self.middle)
        return dots(often, one(generator, 0.3, 0.9), generator) * 2.0
