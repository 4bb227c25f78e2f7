"""What a photo tells of somebody's hair: the style whose silhouette and length are most like it, and its colours.

It is read on cells of a square that holds all of the hair.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from service.anatomy.hair.hair_colour import LEAST_PIXELS, HairColour, guessed, measure_hair
from service.anatomy.hair.names import AUTO, NONE
from service.anatomy.hair.tailored import Tailored, hair_thickness_mm, tailored, to_outline
from service.anatomy.hair.wearables import (
    EAR_M,
    Cut,
    Frame,
    Items,
    Skull,
    agreement,
    fits,
    hair_on,
    mirrored,
    read_items,
)
from service.arrays import Bool, Float32
from service.colour import bytes_to_linear, srgb_to_linear
from service.face.fit.result import Fit
from service.face.reading.part_labels import BEARD, BROW, HAIR, HAT, IRIS, OTHER, SCLERA, SKIN
from service.face.reading.reader import PART_CELLS, Reading, middles, parts_at_pixels
from service.face.region import Region
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.image_filters import ramp
from service.photo.photo import Photo

CELLS = 176
"""Cells along the square: as large as those of the reader's narrow crop, about two millimetres."""
EDGE_CELLS = 3.0
"""Cells from the edge of the photo that tell nothing: what is black beyond it counts in them, too."""
RAMP = (0.15, 0.45)
"""Probability up to which a cell shows no hair, and from which on it does: the reader is unsure at soft edges."""


@dataclass(frozen=True)
class SeenHair:
    """Of each cell of a square in the photo; (C, C) float32 in [0, 1] but for ``pixels`` and ``inside``.

    Attributes:
        region: the square.
        pixels: (C, C, 3) float32 linear RGB, the photo.
        hair, skin, brow: 1 where it shows that; brows lie on the skin and count as such, too.
        known: 0 beside the photo and where something hides whether there is hair.
        inside: bool, whether the cell lies well in the photo.
    """

    region: Region
    pixels: Float32
    hair: Float32
    skin: Float32
    brow: Float32
    known: Float32
    inside: Bool

    @classmethod
    def of(cls, photo: Photo, reading: Reading) -> SeenHair:
        """The narrow crop of the reader where that reaches, and the wider one around it."""
        region = reading.region if reading.around is None else reading.around.region
        count = PART_CELLS if reading.around is None else CELLS
        at = middles(region, count)
        parts = parts_at_pixels(reading, at).reshape(count, count, -1)
        margin = EDGE_CELLS * region.side / count
        inside = ((at >= margin) & (at < np.array(photo.size) - margin)).all(1).reshape(count, count)
        hidden = ramp(_sum(parts, HAT, OTHER), RAMP)
        hair = ramp(_sum(parts, HAIR), RAMP)
        return cls(
            region,
            bytes_to_linear(region.cut(photo.pixels, count)),
            hair,
            ramp(_sum(parts, SKIN, BROW, BEARD, SCLERA, IRIS), RAMP),
            _sum(parts, BROW),
            np.asarray(inside * (1 - hidden), np.float32),
            np.asarray(inside),
        )


def _sum(parts: Float32, *kinds: int) -> Float32:
    return np.asarray(np.clip(parts[..., list(kinds)].sum(-1), 0, 1), np.float32)


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
TAIL_UNSEEN = {"hair/ponytail01": 0.05}
"""What a style has to agree better than others to be worn: its tail is out of sight behind the head, so that it looks
like short hair."""
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
        thick = hair_thickness_mm(frame, shown, known)
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
        agrees = 0.5 * whole + 0.3 * above + 0.2 * length - TAIL_UNSEEN.get(name, 0.0)
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


CERTAIN = 1.0
"""Ramped probability from which on a pixel gives its colour."""
BORDER_CELLS = 2
"""Cells from the border of hair that do not: a blue background made the roots of fair hair lilac."""
BEFORE_M = 0.004
"""How far behind the skin brows are still drawn: they lie on it."""
USUAL_SKIN = np.array([0.52, 0.31, 0.22], np.float32)
"""Linear RGB of skin in a photo whose cheek was not seen."""


@dataclass(frozen=True)
class Hair:
    """Hair of one photo.

    Attributes:
        asked: the option.
        choice: the style, how it is worn, and doubts.
        colour: in the photo's light.
        brow: the shape of brows that agrees best with the photo's; None where it shows none.
        brow_colour: (3,) linear RGB of the brows' dark pixels, in the photo's light.
        tailored: the style fitted to the photo's outline, hairline and length; None where no photo was read.
    """

    asked: str
    choice: Choice
    colour: HairColour
    brow: str | None = None
    brow_colour: Float32 | None = None
    tailored: Tailored | None = None

    @property
    def bald_beneath(self) -> bool:
        """Whether the skin is to be bald: hair is worn as a mesh, or is not wanted."""
        return self.choice.name is not None or self.asked == NONE

    @property
    def doubts(self) -> tuple[str, ...]:
        """Stable codes for the manifest."""
        guess = () if self.colour.measured or self.choice.name is None else ("hair-colour-guessed",)
        return (*self.choice.doubts, *guess)


def find_hair(photo: Photo, head: HeadModel, fit: Fit, reading: Reading | None, asked: str) -> Hair:
    """Hair of the person in a photo.

    Args:
        photo: that was fitted.
        head: the head model.
        fit: camera and vertices.
        reading: of the photo; without one nothing is compared, and the shortest style is worn.
        asked: "auto", "none" or the name of a style.
    """
    skin = USUAL_SKIN if fit.cheek is None else srgb_to_linear(fit.cheek)
    items = read_items()
    if not fits(items, head):
        doubts = () if asked == NONE else ("hair-not-for-this-head",)
        return Hair(asked, Choice(None, Cut(), 0.0, 0.0, doubts), guessed(skin))
    named = None if asked in (AUTO, NONE) else [f"hair/{asked}"]
    if reading is None:
        name = None if asked == NONE else named[0] if named else UNSEEN
        doubts = () if asked != AUTO else ("hair-unseen",)
        return Hair(asked, Choice(name, Cut(), 0.0, 1.0, doubts), guessed(skin))
    seen = SeenHair.of(photo, reading)
    certain = well_within((seen.hair >= CERTAIN) & seen.inside)
    frame = _frame(head, fit, seen)
    brow_colour = _brow(seen)
    brow = None if brow_colour is None else _brow_shape(fit, seen, items, frame)
    if asked == NONE:
        choice, along, fitted = Choice(None, Cut(), 0.0, 0.0), np.zeros_like(seen.hair), None
    else:
        choice, along, fitted = _choose(head, fit, seen, items, frame, named)
    # What hides the scalp may be taken for hair.
    certain = np.zeros_like(certain) if "hair-unseen" in choice.doubts else certain
    found = measure_hair(seen.pixels.reshape(-1, 3), along.ravel(), certain.ravel())
    return Hair(asked, choice, found or guessed(skin, brow_colour), brow, brow_colour, fitted)


def _frame(head: HeadModel, fit: Fit, seen: SeenHair) -> Frame:
    side, scalp = len(seen.hair), vertex_mask(head, "scalp")
    return Frame.of(fit.camera, lambda at: seen.region.to_crop(at, side), side, head, fit.vertices, scalp)


def _choose(
    head: HeadModel, fit: Fit, seen: SeenHair, items: Items, frame: Frame, named: list[str] | None
) -> tuple[Choice, Float32, Tailored | None]:
    """The style, its coordinate from root to tip in the frame, 0 beside it, and the style fitted to the photo.

    What was chosen blindly, or agrees little, is not fitted.
    """
    skull = Skull.of(head, fit.neutral)
    choice = choose(items, skull, frame, seen.hair, seen.skin, seen.known, named)
    if choice.name is None:
        return choice, np.zeros_like(seen.hair), None
    item = items.items[choice.name]
    points = hair_on(item, items, skull, choice.cut)
    along = frame.hair(item, points)[1]
    if choice.doubts:
        return choice, along, None
    worn = mirrored(item, head) if choice.cut.mirrored else item
    fitted = tailored(worn, points, skull, frame, seen.hair, seen.known)
    if fitted.ends_m is not None:
        hung = (fitted.ends_m - EAR_M) / min(float(points[:, 1].min()) - EAR_M, -1e-3)
        choice = replace(choice, cut=replace(choice.cut, length=round(min(max(0.0, float(hung)), 1.0), 3)))
    return choice, along, fitted


def well_within(certain: Bool) -> Bool:
    """Cells of hair well within it, as others are mixed with what lies behind; all cells where too few are."""
    inner = cv2.erode(certain.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=BORDER_CELLS) > 0
    return np.asarray(inner if inner.sum() >= LEAST_PIXELS else certain)


def _brow_shape(fit: Fit, seen: SeenHair, items: Items, frame: Frame) -> str:
    """The brows that overlap most with those of the photo."""
    shown = np.asarray(seen.brow > 0.5, np.float32)
    moved = fit.vertices - items.fitted_head
    masks = ((name, frame.hair(items.items[name], items.items[name].worn(moved), BEFORE_M)[0]) for name in
             items.names("brow"))  # fmt: skip
    return max((agreement(shown, mask, np.ones_like(shown)), name) for name, mask in masks)[1]


def _brow(seen: SeenHair) -> Float32 | None:
    """(3,) linear RGB of the darker half of the brows; None where hardly any are seen."""
    own = seen.pixels[(seen.brow > RAMP[1]) & seen.inside]
    if len(own) < 12:
        return None
    return np.asarray(np.median(own[own.sum(1) <= np.median(own.sum(1))], 0), np.float32)
