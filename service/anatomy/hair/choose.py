"""The style whose silhouette and length agree best with the hair that a photo shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from service.anatomy.hair.item import Items
from service.anatomy.hair.outline import thickness_mm, to_outline
from service.anatomy.hair.silhouette import Frame, agreement
from service.anatomy.hair.skull import Cut, Skull, hair_on, mirrored
from service.arrays import Float32

BALD = 0.55
"""Share of the visible scalp with hair on it below which a head is bald or shaved."""
LEAST_SCALP, LEAST_HAIR = 0.4, 0.5
"""Least share of the scalp in the picture that has to be seen to tell, or area of hair over that of the scalp: a tight
picture shows the hair at the sides. Less is seen under a cap."""
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
WASTE = 0.2
"""Weight of the share of a style's silhouette that has to be cut from it: long hair that is cut short hangs as long
hair does."""
RARE = {"hair/afro01": 0.06, "hair/ponytail01": 0.05}
"""What a style has to agree better than others to be worn: few people have an afro, and a ponytail, out of sight behind
the head, looks like short hair that more people have."""
CROPPED_MM = 4.5
"""Thickness under which hair is cropped to the skin, and is no mesh: of portraits with hair painted on, or fur of 3 to
4 mm, the median is 3.0, of other short hair 6 to 20."""
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
        scalp = float(frame.scalp.sum())
        if not (float(seen.sum()) > LEAST_SCALP * scalp or float((shown * known).sum()) > LEAST_HAIR * scalp):
            return Choice(UNSEEN, Cut(), 0.0, 1.0, ("hair-unseen",))
        thick = thickness_mm(frame, shown, known)
        if share < BALD or (thick is not None and thick < CROPPED_MM):
            return Choice(None, Cut(), 0.0, share)

    asked = names or items.names("hair")

    def score(name: str, cut: Cut) -> tuple[float, float]:
        item = mirrored(items.items[name], skull.head) if cut.mirrored else items.items[name]
        loose = hair_on(items.items[name], items, skull, cut)
        # As it would be worn: what a hairdresser does to its volume is not what tells it from others.
        before, _ = frame.hair(item, loose)
        points = to_outline(loose.astype(np.float64), skull, frame, before, shown, known)[0]
        mask, _ = frame.hair(item, points)
        cut_away = np.maximum(skin, frame.below * known) * (1 - shown)  # see service.anatomy.hair.tailored
        worn = mask * (1 - cut_away)
        whole, above = (agreement(shown, worn, known * zone) for zone in (1.0, 1 - frame.below))
        hung = [float((each * known * frame.below).sum()) for each in (shown, worn)]
        roots = np.sqrt([*hung, LEAST_HUNG * frame.side**2])  # lengths, about
        length = 1.0 - abs(roots[0] - roots[1]) / max(roots)
        face = skin * (1 - shown) * known * (1 - frame.below)  # the reader is unsure where strands lie on cheeks
        bare = float((mask * face).sum()) / max(float(face.sum()), 1.0)
        waste = 1 - float((worn * known).sum()) / max(float((mask * known).sum()), 1.0)
        agrees = 0.5 * whole + 0.3 * above + 0.2 * length - RARE.get(name, 0.0)
        return agrees - FACE * bare - WASTE * waste, whole

    plain = [(name, Cut(mirrored=m)) for name in asked for m in (False, True)]
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
