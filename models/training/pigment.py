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
from models.training.tasks import choice, uniform

OFTEN = 0.12
"""Share of the charts that have each kind."""

MELANIN, BLOOD = (0.85, 1.0, 1.15), (0.15, 1.0, 0.75)
"""Absorption by channel over that in green, of more or less melanin and of more blood."""


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

    @staticmethod
    def _islands(cells: tuple[int, ...], edge: tuple[float, float], sharp: float, generator: torch.Generator) -> Tensor:
        """(h, w) in [0, 1]: where a random field is above ``edge``, standard deviations."""
        field = smooth_field((1, 1, HEIGHT, WIDTH), cells[choice(generator, len(cells))], generator)[0, 0]
        return ((field - uniform(generator, *edge, 1)) * sharp + 0.5).clamp(0.0, 1.0)

    def _vitiligo(self, generator: torch.Generator) -> Tensor:
        one = self._islands((8, 12, 20), (0.7, 1.7), float(uniform(generator, 3.0, 12.0, 1)), generator)
        return torch.maximum(one, one.flip(-1)) if choice(generator, 2) else one  # as often as not on both sides

    def _melasma(self, generator: torch.Generator) -> Tensor:
        one = self._islands((12, 20), (0.2, 1.2), 2.0, generator) * self.face
        return torch.maximum(one, one.flip(-1))

    def _birthmark(self, generator: torch.Generator) -> Tensor:
        return self._islands((5, 8, 12), (1.4, 2.2), float(uniform(generator, 3.0, 15.0, 1)), generator)

    def _flush(self, generator: torch.Generator) -> Tensor:
        return self.middle * self._islands((12, 24, 48), (-1.5, 0.3), 1.0, generator)

    def _tan(self, generator: torch.Generator) -> Tensor:
        """What a cap, a collar or glasses kept from the sun, or all but that."""
        kind, soft = choice(generator, 3), float(uniform(generator, 0.7, 5.0, 1))
        if kind == 2:
            inside = ((self.eyes - uniform(generator, 0.2, 0.6, 1)) * 8.0 / soft + 0.5).clamp(0.0, 1.0)
            return inside
        top, bottom = self.rows
        line = top + (bottom - top) * uniform(generator, *((0.05, 0.3) if kind == 0 else (0.85, 1.1)), 1)
        line = line + 4.0 * smooth_field((1, 1, 1, WIDTH), 4, generator)[0, 0]
        below = torch.sigmoid((torch.arange(HEIGHT).view(-1, 1) - line) / soft)
        return 1.0 - below if kind == 0 else below

    def _freckles(self, generator: torch.Generator) -> Tensor:
        often = uniform(generator, 0.01, 0.1, 1) * (0.3 + self.middle)
        spots = (torch.rand(HEIGHT, WIDTH, generator=generator) < often).float()
        return blur(spots[None, None], float(uniform(generator, 0.3, 0.9, 1)))[0, 0] * 2.0
