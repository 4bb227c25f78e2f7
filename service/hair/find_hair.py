"""The hair of a photo as strands on the fitted head: the pipeline's stage "hair".

::

    photo --read--> HairReading --bank--> likely styles --choose--> one --grow, fit--> strands --paint--> WornHair
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Float32
from service.colour import srgb_to_linear
from service.face.fit.fit import Fit
from service.face.reading.reader import Reading
from service.hair.asked import NONE, AskedHair
from service.hair.bank import Matches, kind_of, match, read_bank
from service.hair.choose import choose
from service.hair.colour import HairColour, asked_colour
from service.hair.groom import Groom, make_groom
from service.hair.paint import painted
from service.hair.reading import HairNetwork, HairReading, read_hair
from service.hair.scalp import Scalp
from service.hair.shape import fitted, seen_share
from service.hair.sight import Sight, overlap
from service.hair.style import LENGTHS, NAMED, Style, style_from_json
from service.hair.worn_hair import WornHair
from service.head.model import HeadModel
from service.photo.photo import Photo

UNREAD = "crop"
"""Style of a head of which nothing was read."""
BALD = 0.22
"""Share of the visible scalp with hair on it below which a head is bald."""
SHAVED = 0.8
"""Probability of styles that are cropped to the skin from which on no strands are worn."""
LEAST_SCALP = 0.35
"""Least share of the scalp in the picture that has to be seen for the hair not to be in doubt."""
POOR, DOUBTFUL = 0.6, 0.5
"""Overlap, and probability of the kind, below which either is in doubt."""
STRANDS_A_TRIAL = 800
"""Strands for each of which one more style is tried: where more are wanted, more time is well spent on choosing."""
USUAL_SKIN = np.array([0.52, 0.31, 0.22], np.float32)
"""Linear RGB of skin in a photo whose cheek was not seen."""


@dataclass(frozen=True)
class SeenHair:
    """What a photo tells of hair before any is grown.

    Attributes:
        skin: of the fitted head; None where no strands are worn whatever the photo shows.
        read, sight: the photo's hair; None where nothing was read.
        matches: how likely the styles of the bank are; None where none was compared.
        unseen: the photo shows too little of the scalp to tell.
        without: what a head is called that wears no strands: none, bald or shaved; empty where strands are worn.
    """

    skin: Scalp | None = None
    read: HairReading | None = None
    sight: Sight | None = None
    matches: Matches | None = None
    unseen: bool = False
    without: str = ""


def see_hair(
    photo: Photo, head: HeadModel, fit: Fit, reading: Reading | None, asked: AskedHair,
    network: HairNetwork | None = None,
) -> SeenHair:  # fmt: skip
    """Read the hair of a photo and compare it with the bank, which soon tells whether strands are worn.

    Args:
        photo: that was fitted.
        head: the head model; one without a region "scalp" wears nothing.
        fit: camera and vertices.
        reading: of the photo; without one, or where its hair cannot be read, nothing is compared.
        asked: the options.
        network: that reads hair; None for the shipped one.
    """
    if asked.style == NONE or "scalp" not in head.region_names:
        return SeenHair(without=NONE)
    skin = Scalp.of(head, fit.neutral)
    read = None if reading is None else read_hair(photo.pixels, reading, network)
    if read is None:
        return SeenHair(skin)
    sight = Sight.of(read, fit, head)
    read = sight.hanging(read)
    if asked.named:
        return SeenHair(skin, read, sight)
    matches = match(read_bank(), sight, fit, head, read)
    grown, known = _on_scalp(sight, skin)
    seen = SeenHair(skin, read, sight, matches, known < LEAST_SCALP)
    if seen.unseen:
        return seen
    cropped = asked.length_mm is None and matches.probability[read_bank().cropped].sum() > SHAVED
    return replace(seen, without="bald" if grown < BALD else "shaved" if cropped else "")


def grow_hair(seen: SeenHair, photo: Photo, fit: Fit, asked: AskedHair, strands: int, seed: int) -> WornHair:
    """Hair of the person in a photo.

    Args:
        seen: what the photo tells.
        photo: that was fitted.
        fit: camera and vertices.
        asked: the options.
        strands: of a full head.
        seed: of all that is random.
    """
    name, none = asked.style if isinstance(asked.style, str) else "custom", np.zeros(0, np.float32)
    skin, sight, matches = seen.skin, seen.sight, seen.matches
    kinds = {} if matches is None else matches.kinds(read_bank())
    if skin is None or seen.without:
        kinds = {seen.without: 1.0} if matches is not None else {}
        why = ("hair-not-for-this-head",) if skin is None and asked.style != NONE else ()
        return WornHair(name, None, seen.without, kinds, none, doubts=why)
    person = USUAL_SKIN if fit.cheek is None else np.asarray(srgb_to_linear(fit.cheek), np.float32)
    if seen.read is None or sight is None or matches is None:
        style = _longer(_asked_style(asked) or NAMED[UNREAD], asked)
        doubts: tuple[str, ...] = () if asked.named else ("hair-unseen",)
    else:
        style = choose(read_bank(), matches, sight, skin, seed, seen.read, strands // STRANDS_A_TRIAL)
        style, doubts = _longer(style, asked), ("hair-unseen",) if seen.unseen else ()
    if matches is not None and sight is not None and asked.length_mm is None:
        groom, shown = fitted(style, sight, skin, seed, strands)
    else:
        groom = make_groom(style, seed, strands, skin)
        shown = np.zeros(len(groom), np.float32) if sight is None else seen_share(groom.strands, sight)
    agreement = 0.0 if sight is None else overlap(sight.hair, sight.drawn(groom.strands).mask, sight.known)
    kind = kind_of(style)
    if matches is not None:
        doubts += ("hair-style-poor",) if agreement < POOR else ()
        doubts += ("hair-kind-doubtful",) if kinds.get(kind, 0.0) < DOUBTFUL else ()
    return _coloured(WornHair(name, groom, kind, kinds, shown, agreement, doubts), photo, sight, person, asked, seed)


def _asked_style(asked: AskedHair) -> Style | None:
    if isinstance(asked.style, dict):
        return style_from_json(asked.style)
    return NAMED.get(asked.style)


def _longer(style: Style, asked: AskedHair) -> Style:
    """The style with its longest strands as long as asked for; what hangs is not cut at a height then."""
    if asked.length_mm is None:
        return style
    factor = asked.length_mm / max(*(getattr(style, name) for name in LENGTHS), 0.1)
    free = dataclasses.replace(style, cut_y=None, fade=style.fade if factor < 3 else 0.0)
    return free.scaled(factor, *LENGTHS)


def _on_scalp(sight: Sight, skin: Scalp) -> tuple[float, float]:
    """Shares of the scalp before the camera: where hair is of what is known, and what the photo shows."""
    cell, seen = sight.visible(*sight.project(skin.even.position))
    facing = sight.facing(skin.even) > 0
    hair, known, shown = (float((one[cell] * (seen & facing)).sum()) for one in (sight.hair, sight.known, sight.shown))
    return hair / max(known, 1e-6), shown / max(float(facing.sum()), 1.0)


def _coloured(
    found: WornHair, photo: Photo, sight: Sight | None, skin: Float32, asked: AskedHair, seed: int
) -> WornHair:
    """The same in the photo's colours, in the photo's light; what was asked for is under white light."""
    groom: Groom | None = found.groom
    if groom is None:
        return found
    colour: HairColour
    if asked.colour != "auto":
        colour = asked_colour(asked.colour, len(groom), seed)
    else:
        colour = painted(photo, sight, groom.strands, found.seen, skin, seed)
    doubts = found.doubts + (() if colour.measured else ("hair-colour-guessed",))
    return replace(found, groom=replace(groom, colour=colour), doubts=doubts, in_photo_light=asked.colour == "auto")
