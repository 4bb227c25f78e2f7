"""Strands as the photo shows them: its combing, its hairline, its outline and its ends.

They are grown along the photo's directions, moved to its outline, cut where it shows none, and bent to where it shows
hair that is still uncovered. What it does not show stays the style's.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from service.arrays import Bool, Float32
from service.geometry.mesh import unit
from service.geometry.nearest import Nearest
from service.hair.groom import Groom, make_groom
from service.hair.guides import CLEARANCE_M, DOWN, Combing, bridge, met, recedes, resampled
from service.hair.outline import to_outline
from service.hair.reading import CELLS
from service.hair.scalp import CROWN, Scalp, gone_along, length_of
from service.hair.sight import Sight
from service.hair.style import Style
from service.image_filters import blurred
from service.robust import smoothstep

FOLLOWS = 0.85
"""How far strands follow a direction that the photo shows for sure."""


def photo_combing(sight: Sight) -> Combing:
    """The photo's directions as a combing: each lifted from the picture to the tangent plane of the body there."""
    forward = sight.camera.rotation[2].astype(np.float32)
    turn = np.array([[np.cos(sight.region.angle), -np.sin(sight.region.angle)],
                     [np.sin(sight.region.angle), np.cos(sight.region.angle)]], np.float32)  # fmt: skip
    axes = sight.camera.rotation[:2].astype(np.float32)
    inner = sight.certainty * (blurred(sight.hair, 1.0) > 0.8)
    field = np.concatenate([sight.direction * inner[..., None], inner[..., None]], -1).astype(np.float32)
    smooth = blurred(field, 1.5)
    sure = np.clip(np.linalg.norm(smooth[..., :2], axis=-1), 0, 1)

    def wish(points: Float32, outwards: Float32) -> tuple[Float32, Float32]:
        cell, seen = sight.visible(*sight.project(points))
        facing = np.clip(-(outwards @ forward) / 0.35, 0, 1)  # beside the outline, the picture hardly tells
        photo = smooth[cell][:, :2] @ turn.T
        along = photo @ axes
        # Of all vectors in the tangent plane the one whose picture is this one.
        slope = (along * outwards).sum(1, keepdims=True) / np.minimum((outwards @ forward)[:, None], -0.3)
        weight = FOLLOWS * sure[cell] * facing * seen
        return unit(along - slope * forward), np.asarray(weight, np.float32)

    return wish


FRINGED = 0.04
"""Value of the head's soft mask of the scalp from which on hair may grow where the photo shows it."""
BRIDGED = 0.5
"""How bald a style is at a place from which on nothing is added there."""
SURE = 0.7
"""How surely the photo has to show hair at a root beyond the usual hairline."""
TOGETHER, ALONE = 3, 4.0
"""Roots next to such a root, and the distance of the farthest of them, over the usual one between roots, from which on
it stands alone."""


def to_hairline(groom: Groom, sight: Sight, skin: Scalp, rng: np.random.Generator) -> Groom:
    """The groom with strands on skin beyond its hairline where the photo shows hair, each like the one beside it."""
    if not len(groom):
        return groom
    more = skin.roots(len(groom), rng, least=FRINGED)
    cell, seen = sight.visible(*sight.project(more.position))
    facing = sight.facing(more) > 0.02
    shown = (sight.hair[cell] > SURE) & (sight.known[cell] > SURE) & seen & facing
    shown &= met(groom.style) * bridge(more) < BRIDGED  # a line of hair along the top of a bald head is its outline
    near = Nearest(groom.strands[:, 0])
    apart, like = near.one(more.position)
    # Where roots are as near as they are among themselves, hair grows already.
    usual = float(np.median(near(groom.strands[:500, 0], 2)[0][:, -1]))
    wanted = shown & (apart > 1.5 * usual)
    if not wanted.any():
        return groom
    # A few strands that stand alone would be a spot on the skin.
    places = more.position[wanted]
    away = Nearest(np.concatenate([groom.strands[:, 0], places]))(places, TOGETHER + 1)[0]
    wanted[wanted] = away[:, -1] < ALONE * usual
    roots = more.chosen(wanted)
    like = like[wanted]
    return groom.joined(roots.position[:, None] - groom.strands[like, :1] + groom.strands[like], roots.uv, like)


BARE = 0.5
"""How surely the photo has to show no hair where a strand is cut."""
NEAR_SKIN_M = 0.005
"""Distance from the skin within which background does not say that there is no hair."""
LEAST_LEFT = 0.3
"""Share of a strand that cutting has to leave; else the whole strand goes."""
HANGS_BELOW_M = -0.04
"""Height below which hair hangs: what is hidden there ends where that beside it does."""
NAPE_LEFT_M = 0.012
"""How far below its root such a strand may hang all the same."""
STEP_M = 0.012
BUST_M, LEAST_LOW = -0.2, 0.02
"""Height of the lower edge of the bust, and share of the strands' points below it that must lie on hair of the photo,
for them to stay as long as they are."""
GONE = 0.15
"""Share of a row of hanging hair that the photo shows, below which the row is beyond its ends."""


def _without_hair(sight: Sight) -> Bool:
    """(C, C) cells where the photo surely shows that there is no hair."""
    return np.asarray(blurred(sight.bare, 0.7) > BARE)


def trimmed(strands: Float32, sight: Sight, skin: Scalp, rng: np.random.Generator) -> tuple[Float32, Bool]:
    """Strands cut where the photo shows that there is no hair, and which of them are left.

    Args:
        strands: (N, P, 3) metres.
        sight: the photo.
        skin: of the fitted head: hair on it is not cut off by the background beside a head that is fitted too large.
        rng: cut ends are uneven.

    Returns:
        (N, P, 3) float32, all of them, and (N,) bool.
    """
    if not len(strands):
        return strands, np.zeros(0, bool)
    points = strands.shape[1]
    cell, seen = sight.visible(*sight.project(strands))
    on_head = np.isfinite(sight.behind)[cell]
    beyond = seen & _without_hair(sight)[cell] & (on_head | (skin.outside(strands) > NEAR_SKIN_M))
    # What grows on a nape that is not seen is no stub.
    tells = seen & (sight.known[cell] > 0.5)
    ends = max(
        _ends(strands[tells][:, 1], blurred(sight.hair, 0.7)[cell][tells]),
        _bust(strands[..., 1], tells & (sight.hair[cell] > 0.5)),
    )
    height = ends + rng.normal(0, 0.006, len(strands))
    height = np.where(seen[:, 0], height, np.minimum(height, strands[:, 0, 1] - NAPE_LEFT_M))
    beyond |= (strands[..., 1] < height[:, None]) & (strands[..., 1] < HANGS_BELOW_M)
    cut = beyond.any(1)
    # By length: strands that were moved have their points farther apart in some places than in others.
    gone = gone_along(strands)
    first, row = beyond.argmax(1), np.arange(len(strands))
    end = np.where(cut, 0.5 * (gone[row, first] + gone[row, np.maximum(first - 1, 0)]), gone[:, -1])
    share = end / np.maximum(gone[:, -1], 1e-9)
    uneven = np.where(cut, rng.uniform(0.94, 1.0, len(strands)), 1.0)
    kept = (share >= LEAST_LEFT) | ~cut
    made = resampled(strands, np.asarray(np.clip(share * uneven, 0.05, 1), np.float32), points)
    return made, np.asarray(kept)


def _ends(height: Float32, hair: Float32) -> float:
    """Height at which the photo's hanging hair ends; minus infinity where it does not tell.

    Of (N,) heights of places of which it tells, and the (N,) hair in [0, 1] that it shows there.
    """
    hangs = height < HANGS_BELOW_M
    step = np.floor((HANGS_BELOW_M - height[hangs]) / STEP_M).astype(int)
    count = np.bincount(step)
    shown = np.bincount(step, np.minimum(2 * hair[hangs], 1))
    share = np.where(count >= 30, shown / np.maximum(count, 1), np.nan)
    told = np.flatnonzero(~np.isnan(share))
    gone = [k for k in told if (share[told[told >= k]] < GONE).all()]
    return float(HANGS_BELOW_M - STEP_M * gone[0]) if gone else -np.inf


def _bust(height: Float32, shown: Bool) -> float:
    """Height at which hair ends of which the photo shows nothing so low; minus infinity where it does.

    How long it is, nobody knows; below the bust it would hang in the air. Of (N, P) heights of strands, and where the
    photo shows hair.
    """
    low = height < BUST_M
    return -np.inf if shown[low].sum() > LEAST_LOW * low.sum() else BUST_M


FILLINGS = 2
"""How often what is still uncovered gets strands."""
UNCOVERED, PER_CELL = 0.4, 14
"""Share of a cell of the photo's hair below which it is uncovered, and strands that it then gets, of 10,000."""
BENT = 2500
"""Most strands out of which the nearest is taken."""
FARTHEST_CELLS = 14.0
"""Most by which a strand is bent to reach an uncovered cell: 55 mm."""
LEAVES = 0.5
"""Most by which a loose strand is bent, over its length."""
FORWARDS_M = 0.015
"""Most by which a strand is bent towards the camera to lie on skin: from behind an ear none comes over it."""
OFF_M = (0.002, 0.008)
"""Range of distances from the skin at which these lie where they cross the face."""


def filled(groom: Groom, sight: Sight, skin: Scalp, rng: np.random.Generator) -> Groom:
    """The groom with more strands through cells where the photo shows hair and it has none.

    Each is the strand that is nearest in the picture, bent from its root on to pass through the cell: at the depth of
    the skin where that lies behind, as a fringe on the forehead does, else at the strand's own.
    """
    uncovered = sight.drawn(groom.strands).mask < UNCOVERED
    lacking = np.argwhere((sight.hair > SURE) & (sight.known > SURE) & uncovered)
    if not len(lacking) or not len(groom):
        return groom
    count = max(1, round(PER_CELL * len(groom) / 10_000))
    cells = np.repeat(lacking[:, ::-1], count, 0) + rng.random((len(lacking) * count, 2))
    strands, points = groom.strands, groom.strands.shape[1]
    places = np.arange(points // 3, points, max(1, points // 10))
    some = rng.permutation(len(strands))[:BENT]
    at, depth = sight.project(strands[some][:, places])
    # A strand that the head hides would come to the front through it.
    own = np.flatnonzero(sight.visible(at, depth)[1])
    if not len(own):
        return groom
    apart, near = Nearest(at.reshape(-1, 2)[own]).one(cells)
    near = own[near]
    column, row = cells.astype(int).T
    # A lock that is bent off the skull stands there alone: there, the outline is moved as a whole.
    height = strands[some[near // len(places)], places[near % len(places)], 1]
    stands = ~np.isfinite(sight.behind[row, column]) & (height > HANGS_BELOW_M)
    deep, face = depth.reshape(-1)[near], sight.behind[row, column]
    reached = (apart < FARTHEST_CELLS) & ~stands & (deep <= face + FORWARDS_M)
    cells, near, deep, face = cells[reached], near[reached], deep[reached], face[reached]
    strand, place = some[near // len(places)], places[near % len(places)]
    wanted = np.where(np.isfinite(face), face - rng.uniform(*OFF_M, len(cells)), deep)
    shift = sight.placed(cells, wanted) - strands[strand, place]
    loose = groom.style.gather == "none"
    if loose:  # a tail that is not told as one hangs beside the neck, and no crop reaches it
        near = np.linalg.norm(shift, axis=1) < LEAVES * length_of(strands[strand])
        strand, place, shift = strand[near], place[near], shift[near]
    share = np.clip(np.arange(points)[None] / np.maximum(place, 1)[:, None], 0, 1)
    bent = strands[strand] + (share**1.5)[..., None] * shift[:, None]
    # It ends a little beyond the cell: the rest of a tail, say, would hang anywhere. Loose hair would be a tuft there.
    ends = np.clip(place / (points - 1) * rng.uniform(1.0, 1.2, len(place)), 0, 1).astype(np.float32)
    bent = resampled(bent.astype(np.float32), np.ones_like(ends) if loose else ends, points)
    bent = np.concatenate([bent[:, :1], skin.pushed(bent[:, 1:], 0.0015)], 1)
    return groom.joined(bent, groom.root_uv[strand], strand)


SEEN_M = 0.015
"""Depth below the outermost strand of a cell down to which strands are seen."""


def seen_share(strands: Float32, sight: Sight) -> Float32:
    """(N,) share of the points of each strand that the photo shows: those nearest to the camera, on its hair."""
    if not len(strands):
        return np.zeros(0, np.float32)
    at, depth = sight.project(strands)
    (rows, columns), before = sight.visible(at, depth)
    nearest = np.full(CELLS * CELLS, np.inf, np.float32)
    flat = rows * CELLS + columns
    np.minimum.at(nearest, flat[before], depth[before])
    shown = before & (depth < nearest[flat] + SEEN_M) & (sight.hair[rows, columns] > 0.5)
    return np.asarray(shown.mean(1), np.float32)


BALD_TOP, LEAST_TOLD = 0.6, 0.2
"""Share of what the photo tells of the top that is bare, from which on the crown behind it is bald, too, and the share
of a place of which it has to tell."""
LONG_MM, HIGH_FOREHEAD = 120.0, 0.3
"""Length at sides and back from which on nobody's top is bald, and the most that the hairline recedes there."""


def seen_thinning(style: Style, sight: Sight, skin: Scalp) -> Style:
    """The style without thinning that the photo does not show.

    It does not show how densely hair grows nor, from the front, whether the crown is bald, unless all before it is;
    where it shows hair at the temples, or a hat, that has not receded beside them either. Above hair that hangs long,
    bare skin is a high forehead.
    """
    if is_long(style):
        return dataclasses.replace(style, density=1.0, crown=0.0, receding=min(style.receding, HIGH_FOREHEAD))
    roots = skin.even
    cell, seen = sight.visible(*sight.project(roots.position))
    shown = seen & (sight.facing(roots) > 0)
    # Where something hides most of it, the little that is known tells nothing.
    known = sight.known * (sight.known > SURE)
    known, without = known[cell], (known * (1 - sight.hair))[cell]

    def bare(weight: Float32) -> float:
        """Share without hair of what the photo shows of a place; 0 where it shows too little of it."""
        whole, told = float(weight.sum()), float((weight * known).sum())
        return float((weight * without).sum()) / told if told > LEAST_TOLD * max(whole, 1e-6) else 0.0

    temples, top = bare(recedes(roots) * shown), bare(bridge(roots) * shown)
    crown = style.crown if top > BALD_TOP or sight.visible(*sight.project(CROWN))[1] else 0.0
    return dataclasses.replace(style, density=1.0, crown=crown, receding=style.receding * min(temples / BALD_TOP, 1.0))


def is_long(style: Style) -> bool:
    """Whether loose hair is so long that nobody's top is bald above it."""
    return style.gather == "none" and min(style.sides_mm, style.back_mm) > LONG_MM


def not_bald(sight: Sight, skin: Scalp) -> Sight:
    """What the photo shows of a head with long hair: behind the forehead it tells nothing where it shows none.

    Under a hat the head is fitted too low, and the forehead lies where the top should.
    """
    roots = skin.even
    cell, seen = sight.visible(*sight.project(roots.position[bridge(roots) > BRIDGED]))
    top = np.zeros_like(sight.known)
    top[cell[0][seen], cell[1][seen]] = 1
    bare = (blurred(top, 1.0) > 0.2) & (sight.hair < SURE)
    return dataclasses.replace(sight, known=np.where(bare, np.float32(0), sight.known))


def fitted(style: Style, sight: Sight, skin: Scalp, seed: int, strands: int) -> tuple[Groom, Float32]:
    """Strands of a style as the photo shows them, and the share of each that it does.

    Args:
        style: to begin with.
        sight: the photo.
        skin: of the fitted head.
        seed: of all that is random.
        strands: of a full head.
    """
    rng = np.random.default_rng([seed, 0xC07])
    style = seen_thinning(style, sight, skin)
    if is_long(style):
        sight = not_bald(sight, skin)
    groom = to_hairline(make_groom(style, seed, strands, skin, photo_combing(sight)), sight, skin, rng)
    moved = groom.strands
    for _ in range(2):
        moved = to_outline(moved, sight, skin)
    groom = dataclasses.replace(groom, strands=moved)
    for _ in range(FILLINGS):
        groom = filled(groom, sight, skin, rng)
    moved, kept = trimmed(groom.strands, sight, skin, rng)
    root, seen = sight.visible(*sight.project(moved[:, 0]))
    kept |= ~(seen & _without_hair(sight)[root])  # not on bare skin
    moved = np.concatenate([moved[:, :1], skin.over_ears.pushed(moved[:, 1:], 0.001, 0.01)], 1)
    groom = groom.chosen(moved[kept], kept)
    return groom, seen_share(groom.strands, sight)


DEEP_M = 0.01
"""How deep hair may lie in the body when it has been turned; else it is turned by half, or not."""
HANGS_OFF_M, HANGS_LOW_M, HANGS_GRAVITY = (0.01, 0.03), (-0.02, -0.07), 0.3
"""Distances from the body, and heights, between which hair begins to hang free, and the gravity of a style from which
on all of it does."""


def upright(groom: Groom, sight: Sight, skin: Scalp) -> Groom:
    """The groom of a head that is tilted in the photo, as it hangs when the head is held upright.

    What hangs free is turned to the head's own downwards, by no more than the tilt; what lies on the skull, and what
    the photo did not draw aside, stays as it is.
    """
    if not len(groom) or groom.style.gather == "bun":
        return groom
    right, down, forward = sight.camera.rotation.astype(np.float32)
    tilt = float(np.arctan2(right[1], -down[1]))  # from the photo's downwards to the head's, round the camera's axis
    points, pieces = groom.strands[:, :-1], np.diff(groom.strands, axis=1)
    off = smoothstep(skin.outside(points), *HANGS_OFF_M)
    free = np.maximum.accumulate(np.maximum(off, smoothstep(points[..., 1], *HANGS_LOW_M)), 1)[..., None]
    hangs = (free * pieces).sum(1)
    # Of the whole strand: pieces of a curl run anywhere.
    aside = np.arctan2(np.cross(hangs, DOWN) @ forward, hangs @ (DOWN - (DOWN @ forward) * forward))
    turn = np.clip(aside, min(tilt, 0), max(tilt, 0)) * min(groom.style.gravity / HANGS_GRAVITY, 1)
    along = (pieces @ forward)[..., None] * forward
    across = pieces - along
    hung = groom.strands[:, 1:]
    for part in (0.5, 1.0):
        angle = part * turn[:, None, None] * free
        turned = along + np.cos(angle) * across + np.sin(angle) * np.cross(forward, across)
        lower = groom.strands[:, :1] + np.cumsum(turned, 1)
        clear = skin.outside(lower).min(1) > -DEEP_M
        hung = np.where(clear[:, None, None], lower, hung)
    hung = np.where(turn[:, None, None] != 0, skin.over_ears.pushed(hung, CLEARANCE_M, DEEP_M), hung)
    return dataclasses.replace(groom, strands=np.concatenate([groom.strands[:, :1], hung], 1))
