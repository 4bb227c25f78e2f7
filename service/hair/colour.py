"""Colours of hair from its melanin, and back.

Absorption follows d'Eon et al. 2011 ("An Energy-Conserving Hair Reflectance Model", section 6.1); the colour of many
strands together and its inverse follow Chiang et al. 2016 ("A Practical and Controllable Hair and Fur Model", eq. 9).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from pydantic import Strict
from pydantic.dataclasses import dataclass as checked_dataclass

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64
from service.checks import CHECKED
from service.colour import luma, srgb_to_linear

EUMELANIN = np.array([0.419, 0.697, 1.37], np.float32)
PHEOMELANIN = np.array([0.187, 0.4, 1.05], np.float32)
"""Absorption by unit concentration in red, green and blue."""
PIGMENTS = np.stack([EUMELANIN, PHEOMELANIN])
_ROUGH = 0.3
"""Azimuthal roughness of a strand."""
WIDTH = 5.969 - 0.215 * _ROUGH + 2.532 * _ROUGH**2 - 10.73 * _ROUGH**3 + 5.574 * _ROUGH**4 + 0.245 * _ROUGH**5
"""By which the square root of what it absorbs darkens a volume of strands."""
SURFACE = 0.003
"""Light that comes out of strands without colour, however black: they are no hole."""
SHINE = 0.008
"""Least white light that any photo has in the colour of hair, which strands mirror: it hides the hue of black hair."""
GREY = 0.006
"""Melanin that is left in a white hair, which is a little yellow."""
HAIRS = 100_000
"""On a head: each of our strands stands for several, some of which may have gone white."""
DYED, DYED_DARK, DARK = 0.4, 2.0, 0.02
"""Spread over the channels of the logarithm of melanin's colour over the hair's, from which on no melanin explains it:
less is the photo's white balance. By so much more in black hair, which mirrors sky, and the luminance at which 1/e of
that is left."""
NEUTRAL = 0.45
"""Saturation (1 - min / max of linear RGB) below which hair without melanin's colour is grey, not dyed."""
KNOTS = 8
"""Places along a strand at which its pigment is told."""


_Amount = Annotated[float, Strict(), Ge(0), Le(20)]
_Share = Annotated[float, Strict(), Ge(0), Le(1)]


@checked_dataclass(frozen=True, config=CHECKED)
class Melanin:
    """Pigment of a head of hair.

    Attributes:
        eumelanin: concentration; 0.04 to 0.2 is blond, 0.45 to 1.4 brown, more is black.
        pheomelanin: concentration; 0.35 to 1 with little eumelanin is red.
        fade: relative loss of pigment from root to tip.
        spread: standard deviation of the logarithm of the concentration from strand to strand.
        grey: share of hairs without pigment; each strand stands for several.
        highlights: share of strands that were lightened, to a quarter of their pigment.
    """

    eumelanin: _Amount
    pheomelanin: _Amount
    fade: _Share = 0.15
    spread: Annotated[float, Strict(), Ge(0), Le(2)] = 0.12
    grey: _Share = 0.0
    highlights: _Share = 0.0

    def amounts(self, strands: int, rng: np.random.Generator) -> Float32:
        """(strands, KNOTS, 2) float32 concentrations of eumelanin and pheomelanin from root to tip; none is white."""
        amount = np.exp(rng.normal(0, self.spread, strands))
        lot = rng.random(strands)
        amount = np.where(lot < self.highlights, 0.25 * amount, amount)
        along = 1 - self.fade * np.linspace(0, 1, KNOTS)
        pigment = np.array([self.eumelanin, self.pheomelanin])
        return np.asarray((amount[:, None] * along)[..., None] * pigment, np.float32)


@dataclass(frozen=True)
class HairColour:
    """Colour of each strand from root to tip, as what the hair absorbs.

    Attributes:
        melanin: (N, KNOTS, 2) float32 at least 0, concentrations of eumelanin and pheomelanin at places that are even
            from root to tip.
        dye: (3,) or (N, KNOTS, 3) float32 at least 0, what dye absorbs beside them in red, green and blue; 0 in hair
            that is not dyed.
        measured: whether the photo shows enough hair to tell; else it is guessed from the brows.
        shine: linear value of the white light that strands mirror besides, in colours that are a photo's.
    """

    melanin: Float32
    dye: Float32
    measured: bool = True
    shine: float = 0.0

    @classmethod
    def of(cls, melanin: Melanin, strands: int, rng: np.random.Generator) -> HairColour:
        """Colour of strands; each that stands for hairs with and without pigment has their mean, as the eye sees it."""
        amounts = melanin.amounts(strands, rng)
        if melanin.grey == 0 or strands == 0:
            return cls(amounts, np.zeros(3, np.float32))
        hairs = max(round(HAIRS / strands), 1)
        white = (rng.binomial(hairs, melanin.grey, strands) / hairs)[:, None, None]
        pigment = np.array([melanin.eumelanin, melanin.pheomelanin])
        bare = pigment * min(1.0, GREY / max(float(pigment.sum()), GREY))
        mixed = (1 - white) * reflected(amounts @ PIGMENTS) + white * reflected(bare @ PIGMENTS)
        return as_absorbed(mixed, dyed_from=0.0)

    @property
    def dyed(self) -> bool:
        """Whether the colour is one that no hair has by nature: neither brown, blond or red, nor grey."""
        if not self.dye.any() or not len(self.melanin):
            return False
        usual = np.median(self.linear().reshape(-1, 3), 0)
        return not is_warm(usual) and bool(1 - usual.min() / max(float(usual.max()), 1e-6) > NEUTRAL)

    def chosen(self, kept: Bool | Int64) -> HairColour:
        """Of the strands of a mask (N,) or an index."""
        return replace(self, melanin=self.melanin[kept], dye=self.dye if self.dye.ndim == 1 else self.dye[kept])

    def as_bright(self, bright: Float32) -> HairColour:
        """With so much more or less of the same pigment that luminances are those (N, KNOTS), in (SURFACE, 1)."""
        absorbs = np.asarray(self.melanin @ PIGMENTS + self.dye, np.float64)
        factor = _as_bright(np.broadcast_to(absorbs, (*bright.shape, 3)), bright)
        dye = self.dye * factor if self.dye.any() else self.dye
        return replace(self, melanin=np.asarray(self.melanin * factor, np.float32), dye=np.asarray(dye, np.float32))

    def linear(self, points: int = KNOTS) -> Float32:
        """(N, points, 3) float32 linear RGB in [0, 1] under white light, even from root to tip."""
        at = np.linspace(0, KNOTS - 1, points)
        low = np.minimum(at.astype(int), KNOTS - 2)
        part = (at - low).astype(np.float32)[None, :, None]
        absorbs = self.melanin @ PIGMENTS + self.dye
        return reflected(absorbs[:, low] * (1 - part) + absorbs[:, low + 1] * part) + np.float32(self.shine)


COLOURS: dict[str, Melanin] = {
    "black": Melanin(3.2, 0.15), "dark_brown": Melanin(1.3, 0.15), "brown": Melanin(0.75, 0.15),
    "light_brown": Melanin(0.38, 0.12), "dark_blond": Melanin(0.2, 0.09), "blond": Melanin(0.11, 0.07),
    "platinum": Melanin(0.03, 0.02), "red": Melanin(0.12, 0.8), "auburn": Melanin(0.5, 0.7),
    "grey": Melanin(1.0, 0.1, grey=0.6), "white": Melanin(0.006, 0.001),
}  # fmt: skip
"""Natural colours by name."""


def asked_colour(asked: str, strands: int, seed: int) -> HairColour:
    """The colour of a name out of ``COLOURS``, or of ``#rrggbb`` (sRGB under white light)."""
    rng = np.random.default_rng([seed, 0xA5C])
    if asked in COLOURS:
        return HairColour.of(COLOURS[asked], strands, rng)
    coded = np.array([int(asked[at : at + 2], 16) for at in (1, 3, 5)], np.float32) / 255
    level = np.exp(rng.normal(0, 0.12, (strands, 1, 1)))
    return as_absorbed(np.clip(srgb_to_linear(coded) * np.repeat(level, KNOTS, 1), 2e-3, 0.9))


def reflected(absorption: AnyFloat) -> Float32:
    """(..., 3) linear RGB of a volume of strands with this absorption (..., 3), with what their surface scatters."""
    inside = np.exp(-np.sqrt(np.maximum(absorption, 0)) * WIDTH)
    return np.asarray(SURFACE + (1 - SURFACE) * inside, np.float32)


def absorption_of(colour: AnyFloat) -> Float32:
    """(..., 3) absorption that gives linear RGB (..., 3): the inverse of :func:`reflected`."""
    logs = np.log(np.clip((colour - SURFACE) / (1 - SURFACE), 1e-9, 1 - 1e-6))
    return np.asarray(np.square(logs / WIDTH), np.float32)


def farther_if_black(bright: float) -> float:
    """By how much more than ``DYED`` hair of a luminance is off melanin's colours where it is dyed."""
    return DYED_DARK * float(np.exp(-bright / DARK))


def as_absorbed(colours: AnyFloat, *, dyed_from: float = DYED, shine: float = 0.0) -> HairColour:
    """Strands (N, KNOTS, 3) of linear RGB in (0, 1) as melanin, and as dye what no melanin explains.

    Args:
        colours: of the strands.
        dyed_from: how far from melanin's colours hair is dyed, as ``DYED``; 0 for a colour that is hair's own all the
            same, as of white hairs and others together, or of copper, which lies beyond what pheomelanin has here;
            minus infinity where the colour is kept whatever it is.
        shine: what they mirror, see :class:`HairColour`.
    """
    colours = np.clip(colours - np.float32(shine), 1.15 * SURFACE, 0.98)
    absorbed = absorption_of(colours).astype(np.float64)
    melanin, dye = _melanin(absorbed), np.zeros(3)
    wanted = luma(np.asarray(colours, np.float32))
    melanin *= _as_bright(melanin @ PIGMENTS, wanted)
    if len(colours):
        usual = np.median(absorbed.reshape(-1, 3), 0)
        amount = np.median(melanin.reshape(-1, 2), 0)
        nearest, shown = reflected(amount @ PIGMENTS), reflected(usual)
        left = np.log((nearest + SHINE) / (shown + SHINE))
        bright = float(luma(shown))
        far = float(left.max() - left.min()) > dyed_from + farther_if_black(bright)
        if far:
            # Whatever melanin there is absorbs no more than the dyed hair does in any channel.
            most = (usual / np.maximum(amount @ PIGMENTS, 1e-9)).min()
            melanin = melanin * min(1.0, float(most))
            dye = np.maximum(usual - np.median(melanin.reshape(-1, 2), 0) @ PIGMENTS, 0)
            dye = dye * absorbed.sum(-1, keepdims=True) / max(float(usual.sum()), 1e-9)  # lighter strands took less
            factor = _as_bright(melanin @ PIGMENTS + dye, wanted)
            melanin, dye = melanin * factor, dye * factor
    return HairColour(np.asarray(melanin, np.float32), np.asarray(dye, np.float32), shine=shine)


def is_warm(colour: AnyFloat) -> bool:
    """Whether a linear RGB (3,) is one of brown, blond or red hair: no channel exceeds the one before it."""
    red, green, blue = colour
    return bool(red >= green >= blue)


def _as_bright(absorbs: Float64, bright: Float32) -> Float64:
    """(..., 1) factors by which hair that absorbs (..., 3) has a luminance (...)."""
    low, high = np.full(bright.shape, -2.0), np.full(bright.shape, 2.0)
    for _ in range(12):
        middle = 0.5 * (low + high)
        over = luma(reflected(absorbs * np.exp(middle)[..., None])) > bright
        low, high = np.where(over, middle, low), np.where(over, high, middle)
    return np.asarray(np.exp(0.5 * (low + high))[..., None])


def _melanin(absorbed: Float64) -> Float64:
    """(..., 2) concentrations, at least 0, that come nearest to absorptions (..., 3), relative to each."""
    bases = PIGMENTS.T.astype(np.float64)
    scale = 1 / np.maximum(absorbed, 1e-3)
    first, second = bases[:, 0] * scale, bases[:, 1] * scale
    wanted = absorbed * scale
    aa, bb, ab = (first**2).sum(-1), (second**2).sum(-1), (first * second).sum(-1)
    a, b = (first * wanted).sum(-1), (second * wanted).sum(-1)
    both = np.maximum(aa * bb - ab * ab, 1e-12)
    eu, pheo = (bb * a - ab * b) / both, (aa * b - ab * a) / both
    eu, pheo = (
        np.where(pheo < 0, a / np.maximum(aa, 1e-12), np.where(eu < 0, 0, eu)),
        np.where(eu < 0, b / np.maximum(bb, 1e-12), np.where(pheo < 0, 0, pheo)),
    )
    return np.asarray(np.maximum(np.stack([eu, pheo], -1), 0))


def natural(albedo: Float32) -> Float32:
    """(3,) linear RGB of the melanin, and dye where no melanin explains it, that comes nearest to an albedo (3,)."""
    return np.asarray(as_absorbed(np.broadcast_to(albedo, (1, KNOTS, 3))).linear()[0, 0])
