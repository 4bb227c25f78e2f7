"""What lies in and on the skin of psi's crops: pigment, which is no gloss, hair and lipstick, which are.

The light stage's pigment follows its pores and its regions, so psi could take any dark or pale patch for another
surface. Pigment is painted on the diffuse albedo alone: moles, freckles, birthmarks, vitiligo, edges of a tan, a shaved
beard's shadow under the skin. Strands of a beard or brow and lipstick change the gloss as on the stage.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional

from models.colour import linear, srgb
from models.lightstage.skin.gloss import HAIR_GLOSS, LIP_GLOSS, LIPSTICK_GLOSS
from models.training.degrade import blur, smooth_field
from models.training.facial_hair import COLOURS, OFTEN, UNDER_SKIN, Places
from models.training.pigment import BLOOD, MELANIN, dots, islands
from models.training.regions import region_planes
from models.training.tasks import Batch, choice, one, uniform

TEXELS_PER_MM = 14.0 / 6144.0
"""Of the face, on a chart that is one texel wide."""

SHARES = {"islands": 0.3, "tan": 0.15, "freckles": 0.25, "moles": 0.25, "shaved": 0.3, "hair": 0.4, "lipstick": 0.3}
"""Share of the crops with each; of the last three, of those where beards and brows grow or lips lie."""

HAIR_WIDTH = 0.08
"""Millimetres."""

LONGEST = 24
"""Half of the longest strand that is drawn, texels."""


class Coverings:
    """Paints crops; knows where beards grow and lips lie."""

    def __init__(self) -> None:
        places = Places.of_head()
        brows = torch.maximum(places.brow, places.brow.flip(-1))
        hairy = torch.maximum(places.beard.amax(0), brows)
        self.planes = torch.stack([hairy, region_planes(("lips",))[0]])

    def __call__(self, batch: Batch, generator: torch.Generator) -> Batch:
        """The same crops with all of it; of the batch are used albedo, specular, place and chart_width."""
        return self.covered(self.pigmented(batch, generator), generator)

    def pigmented(self, batch: Batch, generator: torch.Generator) -> Batch:
        """The same crops with more and less pigment; their gloss stays."""
        skin = linear(batch["albedo"])
        logs = torch.stack([_density(skin.shape[2], scale, generator) for scale in _scales(batch)])
        where = self._at(batch)[:, :1]
        logs = logs + where * _shaved(where.shape, generator) * torch.tensor(UNDER_SKIN).view(1, 3, 1, 1)
        return batch | {"albedo": srgb((skin * torch.exp(-logs)).clamp(0.0, 1.0))}

    def covered(self, batch: Batch, generator: torch.Generator) -> Batch:
        """The same crops with strands of hair and lipstick over them."""
        skin, gloss, n = linear(batch["albedo"]), batch["specular"], len(batch["albedo"])
        hairy, lips = self._at(batch).split(1, 1)
        stick = lips * _some("lipstick", n, generator) * uniform(generator, 0.3, 0.9, n, 1, 1, 1)
        red, pink = uniform(generator, 0.2, 0.6, n, 1, 1, 1), uniform(generator, 0.02, 0.2, n, 2, 1, 1)
        skin = skin + stick * (torch.cat([red, pink], 1) - skin)
        gloss = gloss * (1.0 + stick * (LIPSTICK_GLOSS / LIP_GLOSS - 1.0))
        here = hairy * _some("hair", n, generator)
        strands = torch.stack([_strands(w, s, generator) for w, s in zip(here, _scales(batch), strict=True)])
        colour = COLOURS[torch.multinomial(OFTEN, n, replacement=True, generator=generator)][..., None, None]
        skin = skin + strands * (colour * torch.exp(0.25 * torch.randn(n, 1, 1, 1, generator=generator)) - skin)
        gloss = gloss * (1.0 - (1.0 - HAIR_GLOSS) * strands)
        return batch | {"albedo": srgb(skin.clamp(0.0, 1.0)), "specular": gloss.clamp(0.0, 1.0)}

    def _at(self, batch: Batch) -> Tensor:
        """(N, 2, h, w) in [0, 1]: where beards and brows grow, and where lips lie, under each crop."""
        n, _, h, w = batch["albedo"].shape
        left, top, right, bottom = (2.0 * batch["place"] - 1.0).T.view(4, n, 1, 1)
        share = [((torch.arange(size) + 0.5) / size).view(shape) for size, shape in ((w, (1, 1, w)), (h, (1, h, 1)))]
        x, y = left + (right - left) * share[0], top + (bottom - top) * share[1]
        grid = torch.stack([x.expand(n, h, w), y.expand(n, h, w)], 3)
        return functional.grid_sample(self.planes.expand(n, -1, -1, -1), grid, align_corners=False)


def _scales(batch: Batch) -> list[float]:
    """Texels per millimetre of each crop."""
    return [float(width) * TEXELS_PER_MM for width in batch["chart_width"].flatten()]


def _some(name: str, n: int, generator: torch.Generator) -> Tensor:
    """(N, 1, 1, 1): 1 for a share of the crops, else 0."""
    return (torch.rand(n, 1, 1, 1, generator=generator) < SHARES[name]).float()


def _density(side: int, scale: float, generator: torch.Generator) -> Tensor:
    """(3, h, w) -log of what pigment leaves of the albedo of a crop with ``scale`` texels per mm."""
    kinds: dict[str, tuple[Callable[[int, float, torch.Generator], Tensor], tuple[float, float]]] = {
        "islands": (_islands, (-0.8, 0.9)), "tan": (_tan, (-0.5, 0.5)),
        "freckles": (_freckles, (0.1, 0.8)), "moles": (_moles, (0.4, 2.0)),
    }  # fmt: skip
    logs = torch.zeros(3, side, side)
    for name, (where, depth) in kinds.items():
        if one(generator, 0.0, 1.0) < SHARES[name]:
            colour = BLOOD if name == "islands" and choice(generator, 2) else MELANIN
            tint = torch.tensor(colour) * torch.exp(0.1 * torch.randn(3, generator=generator))
            logs = logs + where(side, scale, generator) * one(generator, *depth) * tint.view(3, 1, 1)
    return logs


def _islands(side: int, _: float, generator: torch.Generator) -> Tensor:
    cells = (2, 3, 5, 8)[choice(generator, 4)]
    return islands((side, side), cells, (0.0, 1.5), one(generator, 1.0, 15.0), generator)


def _tan(side: int, scale: float, generator: torch.Generator) -> Tensor:
    """One side of an uneven line."""
    angle, soft = one(generator, 0.0, 6.3), scale * one(generator, 0.2, 4.0)
    direction = torch.tensor([angle]).cos(), torch.tensor([angle]).sin()
    along = torch.arange(side) - side * one(generator, 0.2, 0.8)
    line = direction[0] * along + direction[1] * along[:, None]
    return torch.sigmoid((line + scale * smooth_field((1, 1, side, side), 6, generator)[0, 0]) / soft)


def _freckles(side: int, scale: float, generator: torch.Generator) -> Tensor:
    """5 to 60 in a square centimetre, 1 to 3 mm wide, denser here and there."""
    size = scale * one(generator, 0.25, 0.7)
    often = one(generator, 0.05, 0.6) / scale**2 * islands((side, side), 4, (-1.0, 0.5), 1.0, generator)
    return (dots(often, size, generator) * 6.3 * size**2).clamp(max=1.5)


def _moles(side: int, scale: float, generator: torch.Generator) -> Tensor:
    """A few discs of 1 to 5 mm, uneven at their rims."""
    axis, uneven = torch.arange(side), smooth_field((1, 1, side, side), 24, generator)[0, 0]
    result = torch.zeros(side, side)
    for _ in range(1 + choice(generator, 4)):
        x, y = (side * one(generator, 0.0, 1.0) for _ in range(2))
        inside = scale * (one(generator, 0.5, 2.5) + 0.1 * uneven) - torch.hypot(axis - x, axis[:, None] - y)
        result = torch.maximum(result, torch.sigmoid(inside / (scale * one(generator, 0.05, 0.25))))
    return result


def _shaved(shape: torch.Size, generator: torch.Generator) -> Tensor:
    """(N, 1, h, w) optical depth of roots under the skin, in grains."""
    n = shape[0]
    noise = 7.0 * blur(torch.randn(shape, generator=generator), 2.0)  # of unit variance
    grain = torch.exp(0.4 * noise * torch.rand(n, 1, 1, 1, generator=generator))
    return _some("shaved", n, generator) * uniform(generator, 0.05, 0.6, n, 1, 1, 1) * grain


def _strands(where: Tensor, scale: float, generator: torch.Generator) -> Tensor:
    """(1, h, w) cover by strands of 0.5 to 5 mm that hang, up to a full beard, as dense as ``where`` (1, h, w) says."""
    if float(where.max()) < 0.05:
        return torch.zeros_like(where)
    half = min(max(scale * one(generator, 0.5, 5.0) / 2.0, 1.0), float(LONGEST))
    roots = where * 10.0 ** one(generator, -1.3, 0.3) / (2.0 * half)  # strands that cross a texel's width
    result = torch.zeros_like(where)
    lean = 0.6 * float(torch.randn(1, generator=generator))
    for _ in range(3):
        angle = torch.tensor(lean + 0.25 * float(torch.randn(1, generator=generator)))
        axis = torch.arange(-LONGEST, LONGEST + 1).float()
        along = axis[:, None] * angle.cos() + axis * angle.sin()
        across = axis * angle.cos() - axis[:, None] * angle.sin()
        width = max(0.5 * HAIR_WIDTH * scale, 0.4)
        kernel = torch.exp(-0.5 * (across / width) ** 2) * (along.abs() <= half)
        begun = (torch.rand(where.shape, generator=generator) < roots / 3.0).float()
        drawn = functional.conv2d(begun[None], kernel[None, None], padding=LONGEST)[0]
        result = torch.maximum(result, drawn.clamp(max=1.0))
    # Strands that are thinner than a texel cover less of it.
    return result * min(HAIR_WIDTH * scale, 1.0) * one(generator, 0.7, 1.0)
