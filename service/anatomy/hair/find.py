"""What a photo tells of somebody's hair: which style it is like, and its colours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.anatomy.hair.choose import UNSEEN, Choice, choose
from service.anatomy.hair.colour import LEAST_PIXELS, HairColour, guessed, measure
from service.anatomy.hair.item import Items, read_items
from service.anatomy.hair.names import AUTO, NONE
from service.anatomy.hair.seen import RAMP, Seen
from service.anatomy.hair.silhouette import Frame, agreement
from service.anatomy.hair.skull import EAR_M, Cut, Skull, fits, hair_on, mirrored
from service.anatomy.hair.tailored import Tailored, tailored
from service.arrays import Bool, Float32
from service.colour import srgb_to_linear
from service.face.fit.result import Fit
from service.face.reading.reader import Reading
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.photo.photo import Photo

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
    seen = Seen.of(photo, reading)
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
    found = measure(seen.pixels.reshape(-1, 3), along.ravel(), certain.ravel())
    return Hair(asked, choice, found or guessed(skin, brow_colour), brow, brow_colour, fitted)


def _frame(head: HeadModel, fit: Fit, seen: Seen) -> Frame:
    side, scalp = len(seen.hair), vertex_mask(head, "scalp")
    return Frame.of(fit.camera, lambda at: seen.region.to_crop(at, side), side, head, fit.vertices, scalp)


def _choose(
    head: HeadModel, fit: Fit, seen: Seen, items: Items, frame: Frame, named: list[str] | None
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
    import cv2

    inner = cv2.erode(certain.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=BORDER_CELLS) > 0
    return np.asarray(inner if inner.sum() >= LEAST_PIXELS else certain)


def _brow_shape(fit: Fit, seen: Seen, items: Items, frame: Frame) -> str:
    """The brows that overlap most with those of the photo."""
    shown = np.asarray(seen.brow > 0.5, np.float32)
    moved = fit.vertices - items.fitted_head
    masks = ((name, frame.hair(items.items[name], items.items[name].worn(moved), BEFORE_M)[0]) for name in
             items.names("brow"))  # fmt: skip
    return max((agreement(shown, mask, np.ones_like(shown)), name) for name, mask in masks)[1]


def _brow(seen: Seen) -> Float32 | None:
    """(3,) linear RGB of the darker half of the brows; None where hardly any are seen."""
    own = seen.pixels[(seen.brow > RAMP[1]) & seen.inside]
    if len(own) < 12:
        return None
    return np.asarray(np.median(own[own.sum(1) <= np.median(own.sum(1))], 0), np.float32)
