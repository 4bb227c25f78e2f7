"""Beards, moustaches, stubble and brows painted over charts: hair covers skin, and the light stays as it was.

The light stage's beards are as its subjects have them, strand by strand, few of them full. A network that has seldom
seen a moustache takes it for the shade under the nose. So hair is painted over captures by chance: from a shaved
beard's shadow under the skin to a full beard, whole or in parts, black to white. Texture and albedo change by the same
factor, at every texel, so the light between them stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from models.colour import linear, srgb
from models.training.degrade import blur, smooth_field
from models.training.paint import moved
from models.training.regions import region_planes
from models.training.tasks import uniform

BEARDED, BROWED = 0.5, 0.5
"""Shares of the charts with a painted beard, and with painted brows."""

STYLES = torch.tensor(
    [[1.0, 1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 1.0, 1.0],
     [1.0, 1.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0], [1.0, 1.0, 0.6, 0.2]]
)  # fmt: skip
"""Strength in moustache, chin, jaw and cheek: full, moustache, goatee, tuft, beard without moustache, trimmed,
sideburns, thin at the sides."""

BEARD_DENSITY, BROW_DENSITY = (0.08, 4.0), (0.3, 4.0)
"""Range of the optical depth of hair, spread evenly in its logarithm: 0.1 is a day's shadow, 3 hides the skin."""

UNDER_SKIN = (0.9, 1.0, 0.75)
"""Absorption by channel of roots that shine through the skin of a shaved beard: it looks blue grey."""

SHAVED = 0.25
"""Share of beards that are roots under the skin, whose optical depth is at most this."""

COLOURS = torch.tensor(
    [[0.008, 0.007, 0.006], [0.016, 0.012, 0.009], [0.03, 0.02, 0.013], [0.07, 0.042, 0.022], [0.11, 0.045, 0.018],
     [0.17, 0.11, 0.06], [0.10, 0.095, 0.09], [0.35, 0.33, 0.31]]
)  # fmt: skip
"""Linear albedo of hair: black, dark brown, brown, light brown, red, blond, grey, white."""
OFTEN = torch.tensor([3.0, 3.0, 2.0, 1.0, 0.5, 0.5, 1.0, 0.5])
"""How often each."""

GRAIN = 0.45
"""Standard deviation of the logarithm of the density from texel to texel of the context's chart."""


@dataclass(frozen=True)
class Places:
    """(h, w) masks in [0, 1] of the parts of a beard on the context's chart, and of the left brow."""

    moustache: Tensor
    chin: Tensor
    jaw: Tensor
    cheek: Tensor
    brow: Tensor

    @classmethod
    def of_head(cls) -> Places:
        """From the regions of the shipped head."""
        beard, lips, brow, nose = region_planes(("beard",), ("lips",), ("brow_left",), ("nose",))
        height, width = beard.shape
        y = torch.arange(height)[:, None].expand(height, width).float()
        x = (torch.arange(width)[None, :].expand(height, width).float() + 0.5 - width / 2).abs()
        weight = lips.sum().clamp(min=1e-6)
        middle, half = float((lips * y).sum() / weight), float((lips * x).sum() / weight) * 2.0
        tip = float(y[nose > 0.5].max()) if bool((nose > 0.5).any()) else middle - 2.0 * half

        def until(values: Tensor, edge: float, soft: float) -> Tensor:
            return torch.sigmoid((edge - values) / soft)

        above = until(y, middle, 1.0) * until(tip - y, 0.0, 1.0)
        moustache = above * until(x, 1.5 * half, 2.0) * (1.0 - lips)
        chin = until(x, 1.3 * half, 2.5) * until(middle - y, 0.0, 1.0) * beard
        jaw = until(-y, -middle - half, 3.0) * (1.0 - until(x, 1.3 * half, 2.5)) * beard
        cheek = (beard - torch.maximum(chin, jaw)).clamp(min=0.0) * (1.0 - until(x, 1.6 * half, 2.0))
        return cls(moustache, chin, jaw, cheek, brow)

    @property
    def beard(self) -> Tensor:
        """(4, h, w) in the order of ``STYLES``."""
        return torch.stack([self.moustache, self.chin, self.jaw, self.cheek])


class Barber:
    """Paints beards and brows; knows where they grow."""

    def __init__(self) -> None:
        self.places = Places.of_head()

    def __call__(self, texture: Tensor, albedo: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Both (N, 3, h, w), sRGB-coded in [0, 1], with the same hair; the light between them stays as it was.

        The third, (N, 1, h, w) in [0, 1], is the share of the skin that a beard covers.
        """
        n = len(texture)
        skin, shown = linear(albedo), linear(texture)
        colour = self._colour(n, generator)
        beard = self._density(self._beard(n, generator), BEARD_DENSITY, BEARDED, generator)
        shaved = torch.rand(n, 1, 1, 1, generator=generator) < SHAVED
        roots = torch.exp(-beard.clamp(max=SHAVED * 2.0) * torch.tensor(UNDER_SKIN).view(1, 3, 1, 1))
        cover = 1.0 - torch.exp(-beard)
        grown = torch.where(shaved, skin * roots, skin + cover * (colour - skin))
        brow = self._density(self._brows(n, generator), BROW_DENSITY, BROWED, generator)
        # Brows are often darker than the beard, and of other people's colour where there is none.
        darker = colour * torch.exp(-uniform(generator, 0.0, 0.8, n, 1, 1, 1))
        grown = grown + (1.0 - torch.exp(-brow)) * (darker - grown)
        # What is bright already has no room for white hair; the light would change where it is cut off.
        factor = (grown / skin.clamp(min=1e-4)).minimum(1.0 / shown.clamp(min=1e-4)).minimum(1.0 / skin.clamp(min=1e-4))
        return srgb((shown * factor).clamp(0.0, 1.0)), srgb((skin * factor).clamp(0.0, 1.0)), cover

    def _beard(self, n: int, generator: torch.Generator) -> Tensor:
        """(N, 1, h, w) where it grows: one of the styles, its edges moved and uneven."""
        style = STYLES.to(generator.device)[torch.randint(len(STYLES), (n,), generator=generator)]
        style = style * uniform(generator, 0.6, 1.0, n, 4)
        shape = (n, 1, *self.places.brow.shape)
        where = (self.places.beard[None] * style[:, :, None, None]).amax(1, keepdim=True)
        shift = torch.randn(n, 2, generator=generator) * torch.tensor([0.006, 0.012])
        where = moved(where, shift[:, None], torch.exp(0.06 * torch.randn(n, 1, 2, generator=generator)))
        uneven = 0.25 * smooth_field(shape, 24, generator) * (where > 0.02)
        edge = uniform(generator, 0.15, 0.6, n, 1, 1, 1)
        return ((where + uneven - edge) / uniform(generator, 0.1, 0.5, n, 1, 1, 1)).clamp(0.0, 1.0)

    def _brows(self, n: int, generator: torch.Generator) -> Tensor:
        """(N, 1, h, w) likewise of both brows, thin to bushy."""
        shift = torch.randn(n, 2, generator=generator) * torch.tensor([0.006, 0.012])
        size = torch.exp(torch.randn(n, 2, generator=generator) * torch.tensor([0.1, 0.3]))
        one = moved(self.places.brow.expand(n, 1, -1, -1), shift[:, None], size[:, None])
        edge = uniform(generator, 0.05, 0.4, n, 1, 1, 1)
        both = torch.maximum(one, one.flip(-1))
        return ((both - edge) / 0.3).clamp(0.0, 1.0)

    @staticmethod
    def _density(where: Tensor, depth: tuple[float, float], share: float, generator: torch.Generator) -> Tensor:
        """(N, 1, h, w) optical depth of hair: its grain runs along strands, which hang."""
        n = len(where)
        least, most = (torch.tensor(value).log() for value in depth)
        amount = torch.exp(least + (most - least) * torch.rand(n, 1, 1, 1, generator=generator))
        noise = torch.randn(where.shape, generator=generator)
        noise = (noise + 1.5 * blur(noise, 0.7)) / 1.3
        grain = torch.exp(GRAIN * noise * torch.rand(n, 1, 1, 1, generator=generator))
        patches = (1.0 + 0.25 * smooth_field(tuple(where.shape), 32, generator)).clamp(min=0.0)
        here = torch.rand(n, 1, 1, 1, generator=generator) < share
        return where * here * amount * grain * patches

    @staticmethod
    def _colour(n: int, generator: torch.Generator) -> Tensor:
        """(N, 3, 1, 1) linear."""
        here = generator.device
        chosen = COLOURS.to(here)[torch.multinomial(OFTEN.to(here), n, replacement=True, generator=generator)]
        about = torch.exp(0.25 * torch.randn(n, 1, generator=generator) + 0.08 * torch.randn(n, 3, generator=generator))
        return (chosen * about).clamp(max=0.6)[..., None, None]
