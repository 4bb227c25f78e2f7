"""Which style a head wears: the likeliest of the bank are grown on it, and the best one's numbers are brought nearer.

What the photo does not show stays the style's. ``service.hair.shape`` then fits the strands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from service.arrays import Int64
from service.hair.bank import Bank, Matches
from service.hair.guides import grow_several, grown
from service.hair.kinds import GATHERED, KINDS, kinds_of
from service.hair.reading import HairReading
from service.hair.scalp import Scalp
from service.hair.sight import Drawn, Sight, overlap
from service.hair.style import LENGTHS, Style

OF_EACH = 0.02
"""Probability from which on the best style of a length and a way of gathering is tried as well."""
TRIED_GUIDES = 260
"""Guides that stand for a style while it is tried."""
ANGLE = 0.12
"""Weight of the direction of visible strands (0 along, 1 against) beside the silhouette's error."""
KIND, UNLIKELY = 0.1, 0.02
"""Weight of the reading's doubt about length and gathering, minus the logarithm of its probability, which is at least
this."""
KEEP = 0.004
"""Gain below which a number stays as the bank has it."""
_LENGTH, _GATHERED = (list(KINDS).index(name) for name in ("length", "gathered"))
_SAME = {"half": "none"}
"""Hair of which a part is pinned back hangs all the same."""


@dataclass(frozen=True)
class Tried:
    """A style on the head, as the photo's camera sees it.

    Attributes:
        style: what was tried.
        loss: 1 less the overlap of silhouettes, what its strands run across the photo's, and how unlikely the reading
            calls its kind.
    """

    style: Style
    loss: float


def choose(
    bank: Bank, matches: Matches, sight: Sight, skin: Scalp, seed: int, read: HairReading, likeliest: int
) -> Style:
    """The style of a bank that fits a photo best.

    Args:
        bank: the styles.
        matches: how likely they are.
        sight: the photo.
        skin: of the fitted head.
        seed: of all that is random.
        read: of the photo.
        likeliest: how many styles are tried, beside the best of each kind.
    """
    rows = candidates(bank, matches, read, likeliest)
    several = list(dict.fromkeys(bank.style(int(row)) for row in rows))
    best = min(tried(several, sight, skin, seed, read), key=lambda one: one.loss)
    changes = {changed: change for change in _changes() if (changed := change(best.style)) != best.style}
    other = tried(list(changes), sight, skin, seed, read)
    helpful = sorted((one for one in other if one.loss < best.loss - KEEP), key=lambda one: one.loss)
    if helpful:
        style, together = helpful[0].style, []
        for one in helpful[1:]:
            style = changes[one.style](style)
            together.append(style)
        best = min([helpful[0], *tried(together, sight, skin, seed, read)], key=lambda one: one.loss)
    return best.style


def candidates(bank: Bank, matches: Matches, read: HairReading, likeliest: int) -> Int64:
    """Rows of the likeliest styles, and of the best of each length and way of gathering that is not unlikely.

    All are tied, plaited or loose as the reading says: from the front, silhouettes hardly tell a bun from a crop.
    """
    kinds = np.tile(bank.kinds[:, [_LENGTH, _GATHERED]], (2, 1))
    chance = np.array([read.kinds["gathered"].get(name, 0.0) for name in GATHERED])
    ways = np.array([GATHERED.index(_SAME.get(name, name)) for name in GATHERED])
    read_as = int(np.bincount(ways, chance).argmax())
    found, kind = np.unique(kinds, axis=0, return_inverse=True)
    kind = kind.ravel()
    order = matches.best(len(kind))
    order = order[(ways[kinds[order, 1]] == read_as) & ~bank.cropped[order]]
    best = order[np.unique(kind[order], return_index=True)[1]]
    share = np.bincount(kind, matches.probability, len(found))[kind[best]]
    return np.asarray(list(dict.fromkeys([*order[:likeliest], *best[share >= OF_EACH]])), np.int64)


def tried(styles: Sequence[Style], sight: Sight, skin: Scalp, seed: int, read: HairReading) -> list[Tried]:
    """Grow the guides of styles and compare them with the photo and with what was read of it."""
    heads = []
    for style in styles:
        rng = np.random.default_rng([seed, 0x7E1])
        heads.append((style, grown(skin.even.chosen(np.arange(TRIED_GUIDES)), style, rng), rng))
    found = []
    for style, guides in zip(styles, grow_several(heads, skin), strict=True):
        loss = 1.0
        if len(guides):
            drawn = sight.drawn(guides)
            own = kinds_of(style, guides)
            # From the front, hair of which a part is pinned back hardly differs from loose hair, which is usual.
            ways = dict(read.kinds["gathered"])
            ways["none"] = ways.get("none", 0.0) + ways.get("half", 0.0)
            chances = [read.kinds["length"].get(own["length"], 0.0), ways.get(own["gathered"], 0.0)]
            doubt = -float(np.log(np.maximum(chances, UNLIKELY)).sum())
            loss = 1 - overlap(sight.hair, drawn.mask, sight.known) + ANGLE * across(drawn, sight) + KIND * doubt
        found.append(Tried(style, loss))
    return found


def across(drawn: Drawn, sight: Sight) -> float:
    """How strands run against those of the photo, 0 (along) over 0.5 (across) to 1 (against), mean by its certainty."""
    cosine = (drawn.direction * sight.direction).sum(-1)
    weight = sight.certainty * sight.known * drawn.mask
    return float((weight * (1 - cosine)).sum() / 2 / max(float(weight.sum()), 1e-6))


Change = Callable[[Style], Style]


def _changes() -> Iterator[Change]:
    """Steps that are tried, first one by one."""
    for sign in (1, -1):
        factor = float(np.exp(sign * 0.45))
        for names in (LENGTHS, ("volume_mm",), ("sides_mm", "back_mm"), ("fringe_mm",)):
            yield lambda s, f=factor, names=names: s.scaled(f, *names)  # type: ignore[misc]
        shift = 0.3 * sign
        yield lambda s, d=shift: dataclasses.replace(s, receding=float(np.clip(s.receding + d, 0, 1)))  # type: ignore[misc]
        low = 0.045 * sign
        yield lambda s, d=low: s if s.cut_y is None else dataclasses.replace(s, cut_y=s.cut_y + d)  # type: ignore[misc]
    yield lambda s: s if s.gather != "none" else dataclasses.replace(s, receding=1.0, crown=1.0, parting="none")
    for parting in ("left", "middle", "right", "none"):
        yield lambda s, p=parting: s if s.gather != "none" else dataclasses.replace(s, parting=p)  # type: ignore[misc]
    for combing in ("forward", "side", "back"):
        yield lambda s, c=combing: s if s.gather != "none" else dataclasses.replace(s, combing=c)  # type: ignore[misc]
