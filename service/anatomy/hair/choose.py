"""The style whose silhouette and length agree best with the hair that a photo shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from service.anatomy.hair.item import Items
from service.anatomy.hair.silhouette import Frame, agreement
from service.anatomy.hair.skull import Cut, Skull, hair_on
from service.arrays import Float32

BALD = 0.55
"""Share of the visible scalp with hair on it below which a head is bald or shaved."""
LEAST_SCALP = 0.4
"""Least share of the scalp in the picture that has to be seen to tell; less is seen under a cap."""
POOR = 0.45
"""Agreement below which the choice is in doubt."""
REFINED = 4
"""Styles whose volume is tried as well. Length is not: hair longer than the photo shows is not made up, and what is too
long is cut (``service.anatomy.hair.tailored``)."""
VOLUMES = (0.7, 1.0, 1.5)
LEAST_HUNG = 0.01
"""Share of the frame from which on hair below the ears counts: a strand does not make it long."""
FACE = 0.35
"""Weight of the share of seen skin above the ears that a style would cover, and that has to be cut from it."""
USUAL = {
    "hair/afro01": 0.6, "hair/bob01": 0.9, "hair/bob02": 0.95, "hair/braid01": 0.85, "hair/long01": 1.0,
    "hair/ponytail01": 0.88, "hair/short01": 0.95, "hair/short02": 1.0, "hair/short03": 0.95, "hair/short04": 1.0,
}  # fmt: skip
"""How usual the styles are: of two that agree alike the plainer is worn."""
UNSEEN = "hair/short04"
"""Worn where the photo does not tell: the shortest."""


@dataclass(frozen=True)
class Choice:
    """What a head wears.

    Attributes:
        name: of the style, "hair/bob01"; None: nothing.
        cut: how it is worn.
        agreement: intersection over union of its silhouette and the photo's hair, in [0, 1]; 0 where none was compared.
        share: of the visible scalp that has hair on it, in [0, 1].
        doubts: stable codes: ``hair-unseen`` where something covers the scalp and the shortest style is worn,
            ``hair-style-poor`` where the best style agrees little.
    """

    name: str | None
    cut: Cut
    agreement: float
    share: float
    doubts: tuple[str, ...] = ()


def choose(
    items: Items, skull: Skull, frame: Frame, shown: Float32, skin: Float32, known: Float32,
    names: list[str] | None = None,
) -> Choice:  # fmt: skip
    """Compare the styles with a photo.

    Args:
        items: styles.
        skull: of the head.
        frame: in which silhouettes are compared.
        shown: (side, side) in [0, 1], 1 where the photo shows hair.
        skin: (side, side) in [0, 1], 1 where it shows skin.
        known: (side, side) in [0, 1], 0 where something hides whether there is hair.
        names: styles to choose from, worn whatever the photo shows; None: all, or nothing for a bald head.
    """
    seen = frame.scalp * known
    share = float((seen * shown).sum() / max(float(seen.sum()), 1e-6))
    if names is None:
        if not float(seen.sum()) > LEAST_SCALP * float(frame.scalp.sum()):
            return Choice(UNSEEN, Cut(), 0.0, 1.0, ("hair-unseen",))
        if share < BALD:
            return Choice(None, Cut(), 0.0, share)

    def score(name: str, cut: Cut) -> tuple[float, float]:
        mask, _ = frame.hair(items.items[name], hair_on(items.items[name], items, skull, cut))
        cut_away = np.maximum(skin, frame.below * known) * (1 - shown)  # see service.anatomy.hair.tailored
        worn = mask * (1 - cut_away)
        whole, above = (agreement(shown, worn, known * zone) for zone in (1.0, 1 - frame.below))
        hung = [float((each * known * frame.below).sum()) for each in (shown, worn)]
        roots = np.sqrt([*hung, LEAST_HUNG * frame.side**2])  # lengths, about
        length = 1.0 - abs(roots[0] - roots[1]) / max(roots)
        face = skin * (1 - shown) * known * (1 - frame.below)  # the reader is unsure where strands lie on cheeks
        bare = float((mask * face).sum()) / max(float(face.sum()), 1.0)
        return USUAL[name] * (0.5 * whole + 0.3 * above + 0.2 * length) - FACE * bare, whole

    plain = [(name, Cut(mirrored=m)) for name in names or items.names("hair") for m in (False, True)]
    scored = sorted(((score(*one), *one) for one in plain), key=lambda s: -s[0][0])
    best = scored[0]
    for _, name, cut in scored[:REFINED]:
        tried = [(score(name, other), name, other) for other in _variants(cut)]
        best = max((best, *tried), key=lambda s: s[0][0])
    doubts = ("hair-style-poor",) if best[0][1] < POOR else ()
    return Choice(best[1], best[2], best[0][1], share, doubts)


def _variants(cut: Cut) -> Iterator[Cut]:
    for volume in VOLUMES:
        if volume != cut.volume:
            yield replace(cut, volume=volume)


def plain_mask(parts: Float32, *kinds: int) -> Float32:
    """(h, w) float32 in [0, 1], sum of the probabilities (h, w, P) of some parts."""
    return np.asarray(np.clip(parts[..., list(kinds)].sum(-1), 0, 1), np.float32)
