"""From a likely style to that of the photo: few of its numbers are tried one after the other, on guides alone.

What the photo does not show stays the style's. ``service.hair.shape`` then fits the strands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from service.hair.guides import grow_guides, grown
from service.hair.kinds import kinds_of
from service.hair.reading import HairReading
from service.hair.scalp import Scalp
from service.hair.sight import Drawn, Sight, overlap
from service.hair.style import LENGTHS, Style

TRIED_GUIDES = 260
"""Guides that stand for a style while its numbers are tried."""
ANGLE = 0.12
"""Weight of the direction of visible strands (0 along, 1 against) beside the silhouette's error."""
KIND, UNLIKELY = 0.05, 0.02
"""Weight of the reading's doubt about length and gathering, minus the logarithm of its probability, which is at least
this. Of 30 people that no network was taught on, weights from 0.03 on raised kinds that are right from 40 to 53 %."""
KEEP = 0.004
"""Gain below which a number stays as the bank has it."""


@dataclass(frozen=True)
class Tried:
    """A style on the head, as the photo's camera sees it.

    Attributes:
        style: what was tried.
        loss: 1 less the overlap of silhouettes, what its strands run across the photo's, and how unlikely the reading
            calls its kind.
        overlap: intersection over union with the photo's hair, in [0, 1].
    """

    style: Style
    loss: float
    overlap: float


def tried(style: Style, sight: Sight, skin: Scalp, seed: int, read: HairReading) -> Tried:
    """Grow the guides of a style and compare them with the photo and with what was read of it."""
    rng = np.random.default_rng([seed, 0x7E1])
    roots = grown(skin.even.chosen(np.arange(TRIED_GUIDES)), style, rng)
    if not len(roots):
        return Tried(style, 1.0, 0.0)
    guides = grow_guides(style, roots, skin, rng)
    drawn = sight.drawn(guides)
    shared = overlap(sight.hair, drawn.mask, sight.known)
    own = kinds_of(style, guides)
    chances = (read.kinds[name].get(own[name], 0.0) for name in ("length", "gathered"))
    doubt = -float(np.log([max(chance, UNLIKELY) for chance in chances]).sum())
    return Tried(style, 1 - shared + ANGLE * across(drawn, sight) + KIND * doubt, shared)


def across(drawn: Drawn, sight: Sight) -> float:
    """How strands run against those of the photo, 0 (along) over 0.5 (across) to 1 (against), mean by its certainty."""
    cosine = (drawn.direction * sight.direction).sum(-1)
    weight = sight.certainty * sight.known * drawn.mask
    return float((weight * (1 - cosine)).sum() / 2 / max(float(weight.sum()), 1e-6))


def refined(style: Style, sight: Sight, skin: Scalp, seed: int, read: HairReading, rounds: int) -> Tried:
    """The style with those of its numbers changed that bring it nearer to the photo.

    Args:
        style: to begin with.
        sight: the photo.
        skin: of the fitted head.
        seed: of all that is random.
        read: of the photo.
        rounds: how often every number is tried.
    """
    best = tried(style, sight, skin, seed, read)
    for turn in range(rounds):
        for change in _changes(0.5**turn):
            changed = change(best.style)
            if changed == best.style:
                continue
            other = tried(changed, sight, skin, seed, read)
            if other.loss < best.loss - KEEP:
                best = other
    return best


Change = Callable[[Style], Style]


def _changes(size: float) -> Iterator[Change]:
    """Steps that are tried, smaller in later rounds."""
    for sign in (1, -1):
        factor = float(np.exp(sign * 0.45 * size))
        yield lambda s, f=factor: s.scaled(f, *LENGTHS)  # type: ignore[misc]
        yield lambda s, f=factor: s.scaled(f, "volume_mm")  # type: ignore[misc]
        yield lambda s, f=factor: s.scaled(f, "sides_mm", "back_mm")  # type: ignore[misc]
        yield lambda s, f=factor: s.scaled(f, "fringe_mm")  # type: ignore[misc]
        if size == 1:
            shift = 0.3 * sign
            yield lambda s, d=shift: dataclasses.replace(s, receding=float(np.clip(s.receding + d, 0, 1)))  # type: ignore[misc]
        low = 0.045 * sign * size
        yield lambda s, d=low: s if s.cut_y is None else dataclasses.replace(s, cut_y=s.cut_y + d)  # type: ignore[misc]
    if size == 1:
        for parting in ("left", "middle", "right", "none"):
            yield lambda s, p=parting: s if s.gather != "none" else dataclasses.replace(s, parting=p)  # type: ignore[misc]
        for combing in ("forward", "side", "back"):
            yield lambda s, c=combing: s if s.gather != "none" else dataclasses.replace(s, combing=c)  # type: ignore[misc]
