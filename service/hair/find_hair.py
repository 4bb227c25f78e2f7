"""The hair of a photo as strands on the fitted head: the pipeline's stage "hair".

::

    photo --read--> HairReading --bank--> likely styles --choose--> one --grow, fit--> strands --paint--> WornHair
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Bool, Float32, Int64
from service.colour import bytes_to_linear, luma, srgb_to_linear
from service.face.fit.fit import Fit
from service.face.reading.reader import Reading
from service.geometry.sampling import sample_at
from service.hair.asked import NONE, AskedHair
from service.hair.bank import UNLIKELY, Bank, Matches, kind_of, match, read_bank
from service.hair.colour import DARK, KNOTS, SHINE, HairColour, as_absorbed, asked_colour, is_warm
from service.hair.groom import make_groom
from service.hair.guides import grow_several, grown, has_fringe
from service.hair.kinds import CURLS, GATHERED, KINDS, kinds_of
from service.hair.reading import CELLS, FINE, HairNetwork, HairReading, read_hair
from service.hair.scalp import Scalp, length_of
from service.hair.shape import fitted, seen_share, upright
from service.hair.sight import SHOWS, Drawn, Sight, overlap
from service.hair.style import LENGTHS, NAMED, WAVES, Curl, Style, style_from_json
from service.hair.worn_hair import WornHair
from service.head.model import HeadModel
from service.image_filters import blurred, ramp
from service.photo.photo import Photo
from service.render.sketch import MIRRORED
from service.words import WarningCode

UNREAD = "crop"
"""Style of a head of which nothing was read."""
BALD = 0.22
"""Share of the visible scalp with hair on it below which a head is bald."""
RIM_CELLS, LIKE_SKIN = 250, 0.5
"""Cells of hair below which it may be the rim of a bare skull, and the natural logarithm of a channel up to which it is
as bright as the skin: the thinnest real hair, of short sides beside a bald top, is 1.06 darker."""
LEAST_SCALP = 0.35
"""Least share of the scalp in the picture that has to be seen for the hair not to be in doubt."""
LEAST_BARE = 0.08
"""Least share that has to be seen for a head to be bald that is bare there: hats leave less."""
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
        without: what a head is called that wears no strands: none or bald; empty where strands are worn.
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
    if seen.unseen and not (grown < BALD and known > LEAST_BARE):
        return seen
    return replace(seen, without="bald" if grown < BALD or only_skin(photo, sight) else "")


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
    skin, sight, matches = seen.skin, seen.sight, seen.matches
    kinds = {} if matches is None else matches.kinds(read_bank())
    if skin is None or seen.without:
        kinds = {seen.without: 1.0} if matches is not None else {}
        why: tuple[WarningCode, ...] = ("hair-not-for-this-head",) if skin is None and asked.style != NONE else ()
        why += ("hair-unseen",) if seen.unseen else ()
        return WornHair(None, seen.without, kinds, np.zeros(0, np.float32), doubts=why)
    person = USUAL_SKIN if fit.cheek is None else np.asarray(srgb_to_linear(fit.cheek), np.float32)
    if seen.read is None or sight is None or matches is None:
        named = style_from_json(asked.style) if isinstance(asked.style, dict) else NAMED.get(asked.style, NAMED[UNREAD])
        style = _longer(named, asked)
        doubts: tuple[WarningCode, ...] = () if asked.named else ("hair-unseen",)
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
    if asked.colour != "auto":
        colour = asked_colour(asked.colour, len(groom), seed)
    else:
        colour = painted(photo, seen.read, sight, groom.strands, shown, person, seed)
    doubts += () if colour.measured else ("hair-colour-guessed",)
    groom = replace(groom, colour=colour)
    if matches is not None and sight is not None:
        groom = upright(groom, sight, skin)
    # What was asked for is under white light.
    return WornHair(groom, kind, kinds, shown, agreement, doubts, in_photo_light=asked.colour == "auto")


def only_skin(photo: Photo, sight: Sight) -> bool:
    """Whether what was read as hair is a rim of the bare skull: it is narrow, and as bright in each colour as the
    forehead.
    """
    hair = sight.hair > 0.6
    brow = sight.project(np.array([0.0, 0.03, 0.02]))[0][1]
    forehead = np.isfinite(sight.behind) & (np.arange(CELLS)[:, None] < brow)
    bare = forehead & (sight.hair < 0.1) & (sight.known > 0.8)
    if not 0 < hair.sum() < RIM_CELLS or not bare.any():
        return False
    bright = np.log(np.maximum(bytes_to_linear(sight.region.cut(photo.pixels, CELLS)), 1e-3))
    return bool(np.abs(np.median(bright[hair], 0) - np.median(bright[bare], 0)).max() < LIKE_SKIN)


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


PIXELS = FINE * CELLS
"""Pixels along the square from which colours are taken."""
LEAST_PIXELS = 150
"""Fewest of them, well within hair, from which its colour is measured: 17 cells."""
LIGHT_CELLS = 7.0
"""Standard deviation of the blur that tells the photo's light on the hair, cells: 27 mm."""
LIGHT_TAKEN = 0.75
"""Power of that light that is taken out: the rest may be a fringe that is fairer."""
BLACK = 0.0035
"""Linear value of the brightest channel up to which a photo's shadow is crushed to black, whatever hair lies in it
(code 11 of 255)."""
RANKS = (0.06, 0.94)
"""Ranks of brightness beyond which pixels are gaps and background, or mirror a lamp."""
MOST_STEEP = 0.8
"""Most by which the logarithm of a channel may rise beside that of luminance: more is two materials."""
VEIL_RANK, VEIL_PIXELS = 0.001, 100_000
"""Rank in each channel of the photo's pixels that count as black, and of how many of them it is taken."""
MOST_VEIL, VEIL_SHARE = 0.04, 0.9
"""Most that is taken for veil, linear, and the largest share of a pixel."""
OWN = 0.7
"""Share of a seen strand's own departure from the mean that it keeps: the rest is its neighbours' and noise."""
CONTRAST = 0.9
"""Least spread of brightness over strands, over that of the photo's pixels: means along strands are more alike."""
AUBURN = 1.5
"""Red over blue from which on hair that is violet in the photo is auburn in a cold light."""
COVERS_M, STUBBLE = 0.004, 0.25
"""Length at which all but 1/e of the skin is covered, and the least that hair has of its colour over skin."""
MOST_SHINE = 0.8
"""Most of the darkest channel of the usual strand that it mirrors: darker ones mirror less."""
USUAL_SPREAD = 0.16
"""Standard deviation of the logarithm of luminance from strand to strand, where none are seen."""
LEAST_LIT = 0.6
"""Least share of the hair that counts as lit where the rest of it is crushed to black."""
DARKEST, BRIGHTEST = 0.006, 0.75
"""Range of linear luminance of hair: what a photo shows darker lies in shadow."""


def painted(
    photo: Photo, read: HairReading | None, sight: Sight | None, strands: Float32, seen: Float32, skin: Float32,
    seed: int,
) -> HairColour:  # fmt: skip
    """Colours of strands in the photo's light: a strand's own where it is seen, else like those that are.

    Brightness is told strand by strand, without the slow changes over the head that are the photo's light. Hue follows
    brightness as it does over all of the hair's pixels: single pixels of dark hair have that of noise and of the sky.

    Args:
        photo: that was fitted.
        read: where its hair is, up to the edge of the photo; None where that is not known.
        sight: the same beside the head.
        strands: (N, P, 3) metres, root first.
        seen: (N,) share of each that the photo shows.
        skin: (3,) linear RGB of the person's skin in the photo; hair is guessed from it where little is seen.
        seed: of what is random.
    """
    rng = np.random.default_rng([seed, 0xC01])
    count = len(strands)
    guess = np.log(np.maximum(skin * np.array([0.12, 0.09, 0.075], np.float32), 1e-4))
    if read is None or sight is None:
        return _guessed(guess, count, rng)
    pixels = without_veil(bytes_to_linear(sight.region.cut(photo.pixels, PIXELS)), photo)
    told = np.kron(_well_within(read, photo), np.ones((FINE, FINE), np.bool_)) & (pixels.max(-1) < 0.98)
    bright = np.log(np.maximum(luma(pixels), 1e-4))
    inner = told & (pixels.max(-1) > BLACK)
    lit = float(inner.sum()) / max(float(told.sum()), 1.0)
    if int(inner.sum()) < LEAST_PIXELS:
        return _guessed(guess, count, rng)
    low, high = np.quantile(bright[inner], RANKS)
    inner &= (bright >= low) & (bright <= high)
    mean = float(bright[inner].mean())
    # What changes slowly over the hair is its light.
    weight = inner.astype(np.float32)
    sigma = LIGHT_CELLS * PIXELS / CELLS
    summed = blurred(np.stack([weight * (bright - mean), weight], -1).astype(np.float32), sigma)
    light = summed[..., 0] / np.maximum(summed[..., 1], 1e-3)
    flat = np.asarray(np.clip(bright - LIGHT_TAKEN * light, low, high), np.float32)
    offset, slope = _hue(np.log(np.maximum(pixels[inner], 1e-4)), bright[inner])
    level = _levels(strands, seen, sight, flat, weight, float(flat[inner].mean()), rng)
    level -= np.median(level)
    level *= np.clip(CONTRAST * float(flat[inner].std()) / max(float(level.std()), 1e-3), 1, 2)
    # As much light comes off all of them as off the hair in the photo.
    arrives = max(lit, LEAST_LIT) * float(np.exp(bright[inner]).mean())
    level = np.minimum(level + np.log(arrives / float(np.exp(level).mean())), high)
    level = np.clip(level, np.log(DARKEST), np.log(BRIGHTEST))
    shown = np.exp(np.clip(offset + slope * level[..., None], -6.5, np.log(0.9)))
    shown *= _without_skin(np.median(shown.reshape(-1, 3), 0), strands, skin, np.exp(guess))
    red, green, blue = usual = np.median(shown.reshape(-1, 3), 0)
    if green < blue < red / AUBURN and luma(usual) > DARK:
        shown[..., 1:] = np.sqrt(shown[..., 1:2] * shown[..., 2:])
    elif is_warm(usual):  # nor are its brighter strands blue, which mirror the sky
        shown = np.minimum.accumulate(shown, -1)
    darkest = float(np.median(shown.reshape(-1, 3), 0).min())
    shine = float(np.clip(MOST_SHINE * darkest, SHINE, MIRRORED))
    return as_absorbed(shown, dyed_from=-np.inf, shine=shine)  # what is pigment in it is told without its light


def without_veil(linear: Float32, photo: Photo) -> Float32:
    """Linear RGB (..., 3) of a photo without the colour that its black has: haze, flare, or the look of faded film.

    On skin it is little, on dark hair half of the blue. A photo none of whose channels is black shows none.
    """
    step = max(1, round((photo.pixels.size / 3 / VEIL_PIXELS) ** 0.5))
    black = bytes_to_linear(np.quantile(photo.pixels[::step, ::step].reshape(-1, 3), VEIL_RANK, 0).astype(np.uint8))
    veil = np.minimum(black - black.min(), MOST_VEIL) if black.min() < BLACK else np.zeros(3, np.float32)
    return np.asarray(np.maximum(linear - veil, (1 - VEIL_SHARE) * linear), np.float32)


def _without_skin(usual: Float32, strands: Float32, skin: Float32, guess: Float32) -> Float32:
    """(3,) factors on the colour of hair (3,), which skin (3,) shines through where it is short.

    The shorter it is, the less do its pixels tell, and the more counts a guess (3,); all linear RGB.
    """
    length = float(np.median(length_of(strands))) if len(strands) else 0.0
    cover = max(1 - np.exp(-((length / COVERS_M) ** 2)), 1e-3)  # stubble stands up, longer hair lies flat
    left = (luma(usual) - (1 - cover) * luma(skin)) / (cover * max(float(luma(usual)), 1e-4))
    alone = usual * max(float(left), STUBBLE)
    told = 1 / (1 + ((1 - cover) / cover) ** 2)
    return np.asarray(alone**told * guess ** (1 - told) / np.maximum(usual, 1e-4), np.float32)


def _well_within(read: HairReading, photo: Photo) -> Bool:
    """(CELLS, CELLS) cells of the photo's hair with hair around them; what lies beyond the photo does not count."""
    whole, (height, width) = read.region.side / CELLS / 2, photo.pixels.shape[:2]
    inside = ((read.cells >= whole) & (read.cells <= np.array([width, height]) - whole)).all(1).reshape(CELLS, CELLS)
    hair = ramp(read.mask, SHOWS) * read.known * inside
    around, shown = (blurred(np.asarray(one, np.float32), 0.8) for one in (hair, inside))
    return np.asarray(inside & (around > 0.75 * shown))


def _guessed(usual: Float32, count: int, rng: np.random.Generator) -> HairColour:
    """Strands of one colour, the logarithm of linear RGB (3,), which differ in brightness."""
    level = rng.normal(0, USUAL_SPREAD, (count, 1)).astype(np.float32)
    colours = np.exp(usual + np.repeat(level, KNOTS, 1)[..., None])
    return replace(as_absorbed(colours, shine=SHINE), measured=False)


def _hue(logs: Float32, bright: Float32) -> tuple[Float32, Float32]:
    """Offset (3,) and slope (3,) of the logarithm of each channel over that of luminance."""
    middle = logs.mean(0), float(bright.mean())
    spread = bright - middle[1]
    size = max(float((spread**2).sum()), 1e-6)
    slope = np.clip((spread[:, None] * (logs - middle[0])).sum(0) / size, 1 - MOST_STEEP, 1 + MOST_STEEP)
    return np.asarray(middle[0] - slope * middle[1], np.float32), np.asarray(slope, np.float32)


def _levels(
    strands: Float32, seen: Float32, sight: Sight, flat: Float32, weight: Float32, mean: float,
    rng: np.random.Generator,
) -> Float32:  # fmt: skip
    """(N, KNOTS) logarithm of luminance of strands from root to tip."""
    at = np.linspace(0, strands.shape[1] - 1, KNOTS).round().astype(int)
    cell, depth = sight.project(strands[:, at])
    _, before = sight.visible(cell, depth)
    place = (cell * (PIXELS / CELLS) - 0.5).reshape(-1, 2)
    soft = blurred(np.stack([flat * weight, weight], -1).astype(np.float32), 1.0)
    read = sample_at(soft, place[:, 0], place[:, 1]).reshape(*cell.shape[:2], 2)
    trust = np.where(before & (read[..., 1] > 0.3), np.clip(2 * seen, 0, 1)[:, None], 0)
    own = np.where(trust > 0, read[..., 0] / np.maximum(read[..., 1], 1e-3), mean) - mean
    # From root to tip as those that are seen, and from strand to strand as they differ.
    told = trust.sum(0)
    along = (trust * own).sum(0) / (told + 20.0)
    per = trust.sum(1)
    middle = (trust * (own - along)).sum(1) / np.maximum(per, 1e-6)
    enough = per > 1.5
    spread = float(np.std(middle[enough])) if int(enough.sum()) > 50 else USUAL_SPREAD
    random = rng.normal(0, float(np.clip(spread, 0.05, 0.35)), len(strands))
    base = np.where(enough, OWN * middle, random)
    detail = trust * (own - along - middle[:, None]) * OWN
    return np.asarray(mean + along + base[:, None] + detail, np.float32)


OF_EACH = 0.02
"""Probability from which on the best style of a length and a way of gathering is tried as well."""
TRIED_GUIDES = 260
"""Guides that stand for a style while it is tried."""
ANGLE = 0.12
"""Weight of the direction of visible strands (0 along, 1 against) beside the silhouette's error."""
KIND, OF_KIND = 0.1, 0.05
"""Weights of the reading's doubt about length and gathering, and of the doubt about its kind that all styles of the
bank together leave, minus the logarithm of the probability: a kind wins, and no single style by luck."""
LEAST_FRINGE_MM = 40.0
"""Shortest fringe of hair that is more than twice as long."""
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
    """The style of a bank that fits a photo best: the likeliest are grown, and the best one's numbers brought nearer.

    What the photo does not show stays the style's. ``service.hair.shape`` then fits the strands.

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
    doubt = {name: -float(np.log(max(share, UNLIKELY))) for name, share in matches.kinds(bank).items()}
    best = min(tried(several, sight, skin, seed, read), key=lambda one: one.loss + OF_KIND * doubt[kind_of(one.style)])
    made = ((change(best.style), change) for change in _changes())
    changes = {changed: change for changed, change in made if changed != best.style and not _bristles(changed)}
    other = tried(list(changes), sight, skin, seed, read)
    helpful = sorted((one for one in other if one.loss < best.loss - KEEP), key=lambda one: one.loss)
    if helpful:
        style, together = helpful[0].style, []
        for one in helpful[1:]:
            style = changes[one.style](style)
            together.append(style)
        best = min([helpful[0], *tried(together, sight, skin, seed, read)], key=lambda one: one.loss)
    return replace(best.style, curl=usual_curl(bank, matches, read))


def usual_curl(bank: Bank, matches: Matches, read: HairReading) -> Curl:
    """The median curl of the likely styles of one class, that which these and the reading together find likeliest.

    Neither a silhouette nor the guides that are tried tell it.
    """
    types = list(WAVES)
    own = np.tile([types.index(style.curl) for style in bank.styles], 2)
    share = np.bincount(own, matches.probability, len(types))
    of_class = np.array([int(name[0]) - 1 for name in types])
    told = np.maximum([read.kinds["curl"].get(name, 0.0) for name in CURLS], 1e-6)
    odds = told * np.bincount(of_class, share, len(CURLS))
    likely = np.where(of_class == odds.argmax(), share, 0)
    return types[int(np.searchsorted(np.cumsum(likely) / likely.sum(), 0.5))]


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


def _bristles(style: Style) -> bool:
    """Whether a style has a fringe too short for the rest of its hair: it would stand off the forehead."""
    return has_fringe(style) and style.fringe_mm < LEAST_FRINGE_MM < style.top_mm / 2


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
