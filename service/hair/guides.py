"""Guides: the few hundred strands that are grown one by one, as a comb, their weight and a tie lead them.

All lengths are metres in the head's frame: +X the subject's left, +Y up, +Z forward, origin between the eyes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32, Int64
from service.geometry.mesh import unit
from service.hair.scalp import CENTRE, CROWN, SHOULDERS, Roots, Scalp, gone_along, length_of
from service.hair.style import LOOSE, Style
from service.hair.style import Combing as Combed
from service.robust import smoothstep

GUIDES, GUIDE_POINTS = 600, 32
DEEP = np.array([0.0, 0.0, 1.0], np.float32)
DOWN = np.array([0.0, -1.0, 0.0], np.float32)
CLEARANCE_M = 0.0012
"""Least distance of hair from skin, away from its root."""
HANGS_AFTER_M = 0.09
"""Length after which a strand's own weight bends it fully."""
COMBED_M = 0.10
"""Length after which combing is forgotten."""
ASIDE = np.array([1.6, 0.0, -0.7], np.float32)
"""Where long hair before the face is pushed, on the left side of the parting."""
CUT_SPREAD_M = 0.004
"""How unevenly scissors cut."""
FACE_M = 0.058
"""Half the width of the face that long hair leaves free."""
SHORT_FRINGE, FRINGE_MM = 0.6, 150.0
"""Share of the length on top, and length, below both of which hair over the forehead is a fringe of its own; what is
longer falls beside the face with the rest."""
Combing = Callable[[Float32, Float32], tuple[Float32, Float32]]
"""Says for points (N, 3) and the body's normals (N, 3) which way hair is combed, (N, 3) unit, and how sure, (N,)."""
SIDES_RAD = 0.85
"""Azimuth at which front becomes side; side becomes back at pi minus it."""
LAYERED_MM, LAYERED_RAD = 130.0, (0.25, 0.65)
"""Difference in length of top and sides that spreads over two radians of elevation, and half of the least and of the
largest such span."""


WISPS_EDGE, WISP_M, WISP_LENGTHS_M = 0.45, 0.007, (0.04, 0.2)
"""How far from the hairline wisps come loose, the width of one, and their lengths."""
RISES_M = 0.007
"""Step of a guide up to which it leaves the skin by its style's whole lift."""
NAPE_M = (-0.095, -0.06)
"""Heights in the head's frame up to which nothing grows on the nape, and from which on hair is full; fluff between."""

NECK_M = -0.1
"""Height in the head's frame where hair that hangs leaves the head."""
BRIDGE_RAD = (0.5, 0.9)
"""Elevations between which hair thins out upwards where baldness of temples and crown have met: a horseshoe is left."""


def grown(roots: Roots, style: Style, rng: np.random.Generator) -> Roots:
    """Roots that this style's hairline, temples and crown leave."""
    azimuth = roots.azimuth
    crown = np.exp(-np.square(np.linalg.norm(roots.position - CROWN, axis=1) / (0.02 + 0.045 * style.crown)))
    phase = rng.uniform(0, 2 * np.pi, 3)
    wander = sum(np.sin(k * azimuth + p) / k for k, p in zip((3, 5, 9), phase, strict=True))
    keep = roots.edge + style.hairline * (0.15 * wander - 0.1)
    keep = keep - style.receding * recedes(roots) - style.crown * 1.6 * crown
    keep = keep - 1.6 * met(style) * bridge(roots, 0.08 * wander)
    keep = keep - smoothstep(roots.position[:, 1] + 0.004 * wander, NAPE_M[1], NAPE_M[0])
    return roots.chosen(keep > rng.uniform(-0.02, 0.22, len(roots)))


def met(style: Style) -> float:
    """How far baldness of temples and crown have met, in [0, 1]."""
    return float(np.clip((style.receding * style.crown - 0.25) / 0.35, 0, 1))


def bridge(roots: Roots, wander: Float32 | float = 0.0) -> Float32:
    """(N,) float32 in [0, 1]: what is lost last, between temples and crown, above the horseshoe that is never lost."""
    front = np.exp(-np.square(roots.azimuth / 0.7))
    return smoothstep(roots.elevation + wander + 0.5 * front, *BRIDGE_RAD)


def recedes(roots: Roots) -> Float32:
    """(N,) float32 in [0, 2.5]: how soon hair that recedes is lost there: temples first, then the forehead."""
    azimuth, elevation = roots.azimuth, roots.elevation
    # From its line upwards: what grows lower at the same azimuth goes first.
    temples = np.exp(-np.square((np.abs(azimuth) - 0.62) / 0.3) - np.square(np.maximum(elevation - 0.72, 0) / 0.38))
    forehead = np.exp(-np.square(azimuth / 0.5) - np.square(np.maximum(elevation - 0.8, 0) / 0.25))
    return np.asarray(1.8 * temples + 0.7 * forehead, np.float32)


def lengths(style: Style, roots: Roots, rng: np.random.Generator) -> Float32:
    """(N,) metres of each strand by where it grows."""
    front = smoothstep(np.abs(roots.azimuth), SIDES_RAD + 0.25, SIDES_RAD - 0.25)
    back = smoothstep(np.abs(roots.azimuth), np.pi - SIDES_RAD - 0.3, np.pi - SIDES_RAD + 0.3)
    around = back * style.back_mm + (1 - back) * style.sides_mm
    # Hair is cut layer by layer: over a sharper border all ends would lie at one height and make a step.
    layered = np.clip(np.abs(style.top_mm - around) / LAYERED_MM, *LAYERED_RAD)
    high = smoothstep(roots.elevation, 0.7 - layered, 0.7 + layered)
    low_front = front * (1 - smoothstep(roots.elevation, 0.85, 1.1))
    length = high * style.top_mm + (1 - high) * around
    length = low_front * style.fringe_mm + (1 - low_front) * length
    if style.fade > 0:  # clipped from the nape and the sides upwards
        clipped = 1 - smoothstep(roots.elevation + 0.25, style.fade * 1.1 - 0.25, style.fade * 1.1 + 0.15)
        length = length * (1 - clipped * (1 - front)) + 2.0 * clipped * (1 - front)
    uneven = 1 + 0.05 * rng.normal(0, 1, len(roots))
    return (length * np.clip(uneven, 0.7, 1.3) / 1000).astype(np.float32)


def _fringe(roots: Roots) -> Bool:
    """(N,) what grows over the forehead."""
    return np.asarray((np.abs(roots.azimuth) < SIDES_RAD) & (roots.elevation < 1.0))


def has_fringe(style: Style) -> bool:
    """Whether hair over the forehead is a fringe, cut shorter than the rest."""
    return style.fringe_mm < min(SHORT_FRINGE * style.top_mm, FRINGE_MM)


PARTED_M, PARTED_LOW_M = (-0.12, -0.08), (0.05, 0.08)
"""Depths and heights in the head's frame between which a parting ends: down the back hair falls as it grows."""


def _parted(style: Style, roots: Roots) -> Bool:
    """(N,) where hair keeps to its own side of a parting; two plaits are parted down to the nape."""
    _, height, depth = roots.position.T
    ends = (depth < _chance(roots, *PARTED_M)) & (height < _chance(roots, *PARTED_LOW_M)) & ~_forward(roots)
    return np.asarray(~ends | (style.gather == "two_plaits"))


def _chance(roots: Roots, low: float = 0.0, high: float = 1.0) -> Float32:
    """(N,) float32 from low to high by place, so that strands and guides of one lock agree."""
    chance = np.sin(np.floor(roots.position / WISP_M) @ np.array([12.9898, 78.233, 37.719])) * 43758.5453 % 1.0
    return np.asarray(low + (high - low) * chance, np.float32)


def _forward(roots: Roots) -> Bool:
    """(N,) what falls before the shoulders where it is long enough; the rest falls behind them."""
    return np.asarray(np.abs(roots.azimuth) < _chance(roots, 1.2, 1.5))


def groups(style: Style, roots: Roots, parting: float | None = None) -> Int64:
    """(N,) number of the part of the hair that a strand belongs to: strands are not blended across these borders.

    ``parting`` is where the photo shows one (:func:`seen_parting`).
    """
    split = style.parting != "none" or style.combing in ("side", "down") or style.gather in ("pinned", "two_plaits")
    split |= parting is not None
    longest, parted = max(style.top_mm, style.sides_mm, style.back_mm), _parted(style, roots)
    parts = (
        (sides_of(style, roots, parting) > 0) & split & parted,
        parted & split,
        _tied(style, roots) & (style.gather != "none"),
        _forward(roots) & (longest > 200) & (style.gather in LOOSE),
        _fringe(roots) & has_fringe(style),
    )
    return sum((part.astype(np.int64) << bit for bit, part in enumerate(parts)), np.zeros(len(roots), np.int64))


_COMBED: Mapping[Combed, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "natural": ((0, -0.3, 0, 1, 0), (0, -0.3, 0, 1, 0)), "down": ((1.3, -0.4, -0.25, 0, 0), (0, -1, 0, 1, 0)),
    "back": ((0, 0.25, -1, 0, 0), (0, -0.35, -1, 0, 0)), "forward": ((0, 0, 0.9, 1, 0), (0, 0, 0.9, 1, 0)),
    "side": ((1.2, 0, 0.35, 0, 0), (0, -0.5, 0, 1, 0)), "up": ((0, 0, 0.2, 0.3, 0.6), (0, 0, 0, 0.3, 0.6)),
}  # fmt: skip
"""How hair is combed on the front of the head and on the rest: away from the parting, up, ahead, as it turns away from
the crown, and out of the head."""


PARTED = 0.5
"""How far hair that is tied behind leaves its parting sideways, over how far it goes straight to the tie."""
PARTINGS_M = {"none": 0.0, "middle": 0.0, "left": 0.028, "right": -0.028}
"""Where a parting lies, metres to the subject's left."""


TOP_RAD, TOP_Z_M = 0.5, -0.05
"""Elevation and depth from which on a root tells on which side of a parting it lies."""
PARTED_MORE, LEAST_ASIDE = 0.2, 0.1
"""Share of what the photo's combing tells that has to speak for its own parting against the style's, and how far it
has to run sideways, times how sure it is, to tell."""


def _parting(style: Style) -> float:
    """Where a style parts, metres to the subject's left."""
    if style.combing == "side" and style.parting in ("none", "middle"):
        return 0.04  # all to one side but what grows over that ear
    return PARTINGS_M[style.parting]


def seen_parting(style: Style, roots: Roots, wish: Combing | None) -> float | None:
    """Where the photo's combing parts, metres to the subject's left; None where it does not tell better than the style.

    Else what grows between the two would be combed to one side by the photo and fall to the other by its style.
    """
    top = roots.chosen((roots.elevation > TOP_RAD) & (roots.position[:, 2] > TOP_Z_M))
    if wish is None or not len(top):
        return None
    own, sure = wish(top.position, top.normal)
    aside = own[:, 0] * sure
    places = np.array([_parting(style), *np.linspace(-0.07, 0.07, 29)])
    agrees = np.where(top.position[:, 0] >= places[:, None], aside, -aside).sum(1)
    best = int(agrees.argmax())
    more = float(agrees[best] - agrees[0]) / max(float(np.abs(aside).sum()), 1e-6)
    return float(places[best]) if more > PARTED_MORE and np.abs(aside).mean() > LEAST_ASIDE else None


def sides_of(style: Style, roots: Roots, parting: float | None = None) -> Float32:
    """(N,) +1 where a strand falls to the subject's left of a parting, the style's if None, and -1 to its right."""
    at = _parting(style) if parting is None else parting
    return np.where(roots.position[:, 0] >= at, 1.0, -1.0).astype(np.float32)


def grow_several(
    heads: Sequence[tuple[Style, Roots, np.random.Generator]], skin: Scalp, wish: Combing | None = None,
    parting: float | None = None,
) -> list[Float32]:  # fmt: skip
    """(G, 32, 3) guides of each of several styles on one head, each with its own roots and random numbers: combed,
    lifted, bent by their weight, gathered where that is asked for; ``wish`` and ``parting`` are the photo's.
    """
    made, hanging, places = [], [], []
    for style, roots, rng in heads:
        length = lengths(style, roots, rng)
        free = np.ones(len(roots), bool)
        guides = np.zeros((len(roots), GUIDE_POINTS, 3), np.float32)
        if style.gather != "none":
            free = ~_tied(style, roots)
            if style.gather not in LOOSE:
                length = np.where(free, np.minimum(length, rng.uniform(*WISP_LENGTHS_M, len(roots))), length)
            if (~free).any():
                guides[~free] = _gathered(style, roots.chosen(~free), length[~free], skin, rng, parting)
        if free.any():
            hanging.append(_Hanging.of(style, roots.chosen(free), length[free], rng, parting))
            places.append((style, guides, free, rng))
        made.append(guides)
    if hanging:
        whole = _Hanging(*map(np.concatenate, zip(*(vars(one).values() for one in hanging), strict=True)))
        ends = np.cumsum([len(one.place) for one in hanging])
        for (style, guides, free, rng), own in zip(places, np.split(whole.grown(skin, wish), ends[:-1]), strict=True):
            guides[free] = _cut(style, own, rng)
    return made


@dataclass(frozen=True)
class _Hanging:
    """Strands that hang, N of any number of styles, each with its own numbers.

    Attributes:
        front, rest: (N, 5) weights as in ``_COMBED``, on the front of the head and on the rest.
        side: (N,) +1 or -1: on which side of the parting it grows.
        fringe: (N,) bool, what lies over the forehead.
        tucked: (N,) how much of it goes behind the ears.
        along: (N,) 1 where it lies along the skin, 0 where it is combed up.
        place, normal: (N, 3) root, and the skin's normal there.
        step: (N, 1) metres from point to point.
        rising, astray: (N, 1) how far it rises from the skin, and (N, 3) by what it goes astray.
        stiff, flat, gravity: (N, 1) weights of going on, of the comb, and of hanging.
        layer: (N,) metres that it lies off the skin.
        before: (N,) bool, whether it falls before the shoulders.
    """

    front: Float32
    rest: Float32
    side: Float32
    fringe: Bool
    tucked: Float32
    along: Float32
    place: Float32
    normal: Float32
    step: Float32
    rising: Float32
    astray: Float32
    stiff: Float32
    flat: Float32
    gravity: Float32
    layer: Float32
    before: Bool

    @classmethod
    def of(
        cls, style: Style, roots: Roots, length: Float32, rng: np.random.Generator, parting: float | None = None
    ) -> _Hanging:
        """Of one style."""

        def each(value: float) -> Float32:
            return np.full((len(roots), 1), value, np.float32)

        front, rest = (np.tile(np.array(weights, np.float32), (len(roots), 1)) for weights in _COMBED[style.combing])
        if style.parting != "none" and style.combing in ("natural", "forward"):
            front[:, 0] += 0.8
        fringe = _fringe(roots) & (style.combing == "forward" or has_fringe(style))
        step = np.asarray(length / (GUIDE_POINTS - 1), np.float32)[:, None]
        # Hair from higher up lies over hair from below, so the body of hair gets its thickness.
        layer = 0.25 + 0.75 * smoothstep(roots.elevation, -0.6, 1.2)
        layer = (layer * rng.uniform(0.5, 1.0, len(roots))).astype(np.float32) * np.float32(style.volume_mm / 1000)
        # Long strands have long steps: the first of them must not carry them farther from the skin than short ones'.
        rising = style.lift * np.clip(RISES_M / np.maximum(step[:, 0], 1e-6), 0.3, 1)
        # What pins leave at the temples is a lock or two: it falls behind the shoulders with the rest.
        before = _forward(roots) & (rng.random(len(roots)) >= style.tucked) & (style.gather != "pinned")
        off_crown = np.linalg.norm(roots.position - CROWN, axis=1, keepdims=True)
        # Long strands that stray would lie across all the others, or before the face.
        strays = 0.7 - 0.6 * smoothstep(step * (GUIDE_POINTS - 1), 0.05, 0.12)
        astray = strays * rng.normal(0, 1, (len(roots), 3)) * np.exp(-np.square(off_crown / 0.035))
        astray -= roots.normal * (astray * roots.normal).sum(1, keepdims=True)  # it whirls, it does not stand up
        return cls(
            front, rest, sides_of(style, roots, parting), fringe,
            each(style.tucked)[:, 0], each(style.combing != "up")[:, 0],
            roots.position, roots.normal, step, rising[:, None].astype(np.float32), astray.astype(np.float32),
            each(0.4 + 1.6 * style.stiffness), each(1 - style.lift), each(style.gravity), layer, before,
        )  # fmt: skip

    def combed(self, points: Float32, outwards: Float32) -> Float32:
        """(N, 3) unit directions along the skin in which hair at points (N, 3) with normals (N, 3) there is combed."""
        x, y, z = np.ascontiguousarray((points - CROWN).T)
        ox, oy, oz = np.ascontiguousarray(outwards.T)
        # On the whorl itself all directions meet; there hair lies backwards, as it does on most heads.
        whorl = 0.03 * np.exp(-(x * x + y * y + z * z) / np.float32(0.03**2))
        turned = x + 0.5 * (oy * z - oz * y), y + 0.5 * (oz * x - ox * z), z + 0.5 * (ox * y - oy * x) - whorl
        front = smoothstep(points[:, 2], -0.09, -0.02)[:, None]
        aside, up, ahead, turn, out = (self.rest + front * (self.front - self.rest)).T
        wish = turn[:, None] * unit(np.stack(turned, 1)) + out[:, None] * outwards
        wish += np.stack([aside * self.side, up, ahead], 1)
        if self.tucked.any():
            far, height, depth = np.abs(points[:, 0]), points[:, 1], points[:, 2]
            beside = smoothstep(far, 0.03, 0.05) * smoothstep(height, 0.06, 0.02) * smoothstep(depth, -0.10, -0.04)
            behind = np.array([0, -0.25, -1.2], np.float32)
            wish = wish + (3.0 * self.tucked * beside)[:, None] * (behind - 0.5 * wish)
        # Where the skin faces backwards, no comb points out of it: without this, hair on the nape would stand up.
        wish[:, 1] -= self.along * np.square(np.maximum(-oz, 0)) * np.maximum(-ahead, 0)
        wish = np.where(self.fringe[:, None], np.array([0, -0.6, 1], np.float32) + 0.25 * wish, wish)
        return unit(wish - outwards * ((wish * outwards).sum(1) * self.along)[:, None])

    def grown(self, skin: Scalp, wish: Combing | None) -> Float32:
        """(N, 32, 3) their points, before they are cut."""
        place, step, side = self.place, self.step, self.side
        comb = self.combed(place, self.normal)
        if wish is not None:
            own, sure = wish(place, self.normal)
            comb = unit(comb * (1 - sure[:, None]) + own * sure[:, None])
        heading = unit(unit(self.rising * self.normal + (1.02 - self.rising) * comb) + self.astray)
        long = smoothstep(step * (GUIDE_POINTS - 1), 0.09, 0.14)
        points = [place]
        for k in range(1, GUIDE_POINTS):
            gone = np.minimum(k * step, 1.0)
            outwards = skin.outwards(place)
            fades = np.exp(-gone / COMBED_M)
            weight = self.gravity * np.clip(gone / HANGS_AFTER_M, 0, 1.5)
            bent = self.stiff * heading + 0.5 * self.flat * fades * self.combed(place, outwards) + weight * DOWN
            aside = long * (_before_face(place) * side)[:, None] * ASIDE
            heading = unit(bent + aside + _draped(place, self.before)[:, None] * DEEP)
            if wish is not None:
                own, sure = wish(place, outwards)
                heading = unit(heading + 1.5 * sure[:, None] * own)
            rise = np.minimum(gone[:, 0] * 0.6, self.layer) + CLEARANCE_M
            tried = skin.pushed((place + step * heading).astype(np.float32), rise.astype(np.float32))
            loose = np.maximum(skin.outside(tried) - 1.5 * self.layer - CLEARANCE_M, 0)
            lies = long * self.flat * fades * smoothstep(tried[:, 1], 0.0, 0.04)[:, None]
            tried = np.asarray(tried - outwards * loose[:, None] * lies, np.float32)
            tried = _beside_face(tried, side, long[:, 0] * ~self.fringe)
            heading = unit(tried - place)
            place = np.asarray(place + step * heading, np.float32)
            points.append(place)
        return np.stack(points, 1)


def _draped(points: Float32, before: Bool) -> Float32:
    """(N,) how far forward (negative: back) hair below the ears is drawn: it falls before or behind the shoulders."""
    middle, radii = SHOULDERS
    wanted = np.where(before, middle[2] + radii[2] + 0.02, middle[2] - radii[2] - 0.015)
    low = smoothstep(points[:, 1], -0.06, -0.14)
    return np.asarray(low * np.clip((wanted - points[:, 2]) / 0.04, -1.2, 1.2), np.float32)


def _beside_face(points: Float32, side: Float32, long: Float32) -> Float32:
    """Points (N, 3) of hair that is too long for a fringe, moved towards the sides of the face, step by step."""
    half = FACE_M * smoothstep(points[:, 1], 0.055, 0.02) * smoothstep(points[:, 2], -0.03, 0.005)
    missing = np.maximum(half - points[:, 0] * side, 0) * long
    moved = points.copy()
    moved[:, 0] += 0.45 * side * missing
    return moved


def _before_face(points: Float32) -> Float32:
    """(N,) 1 before the middle of the face, 0 beside it: nobody wears long hair there."""
    across = 1 - smoothstep(np.abs(points[:, 0]), 0.035, 0.062)
    return across * smoothstep(points[:, 2], -0.03, 0.0) * (1 - smoothstep(points[:, 1], 0.04, 0.075))


def _cut(style: Style, guides: Float32, rng: np.random.Generator) -> Float32:
    """Guides that end where they first fall below the height of the cut, or would if they hung straight down from
    there on where the neck begins: hair on shoulders is no longer than the rest. Others keep their length.
    """
    if style.cut_y is None:
        return guides
    gone, low = gone_along(guides), guides[..., 1] < NECK_M
    start = np.where(low.any(1), low.argmax(1), GUIDE_POINTS - 1)[:, None]
    hung = np.take_along_axis(guides[..., 1], start, 1) - (gone - np.take_along_axis(gone, start, 1))
    heights = np.where(low, np.minimum(guides[..., 1], hung), guides[..., 1])
    reach = -style.cut_y + 0.05
    height = style.cut_y + rng.normal(0, CUT_SPREAD_M, len(guides))
    height = height + style.layers * reach * 0.33 * rng.random(len(guides))
    below = heights < height[:, None]
    first = np.where(below.any(1), below.argmax(1), GUIDE_POINTS - 1)
    ends = np.clip(first, 2, GUIDE_POINTS - 1).astype(np.float32)
    return resampled(guides, np.asarray(ends / (GUIDE_POINTS - 1), np.float32), GUIDE_POINTS)


def _tied(style: Style, roots: Roots) -> Bool:
    """(N,) whether strands reach the tie: all but wisps, the upper ones of a half-up, the front ones where pinned."""
    if style.gather == "half_up":
        return np.asarray(roots.elevation > 0.35)
    if style.gather == "pinned":
        return np.asarray((np.abs(roots.azimuth) < 1.5) & (roots.elevation > 0.0))
    beside = (np.abs(np.abs(roots.azimuth) - 1.05) < 0.65) & (roots.edge < WISPS_EDGE)
    return np.asarray(~(beside & (_chance(roots) < style.wisps)))


def _ties(style: Style, roots: Roots, skin: Scalp) -> Float32:
    """(N, 3) metres of the tie that each strand runs to, a little off the skin."""
    if style.gather in ("two_plaits", "pinned"):
        side = np.where(roots.position[:, 0] >= 0, 1.0, -1.0)
        low = min(style.tie_y, -0.02)
        near = np.stack([0.085 * side, np.full(len(roots), low), np.full(len(roots), -0.10)], 1)
    else:
        near = np.tile([0.0, style.tie_y, -0.2 + 0.9 * max(style.tie_y - 0.03, 0.0)], (len(roots), 1))
    near = near.astype(np.float32)
    for _ in range(8):  # from outside onto the skin
        near = near - (skin.outside(near) - 0.012)[:, None] * skin.outwards(near)
    return near.astype(np.float32)


def _round_head(start: Float32, end: Float32, share: Float32, aside: Float32) -> Float32:
    """(N, S, 3) points from places on the head (N, 3) to others, round its middle and not through it.

    Opposite places are joined over the top: hair on the forehead is combed back, and by ``aside`` (N, 3) to one side.
    """
    first, last = unit(start - CENTRE), unit(end - CENTRE)
    apart = smoothstep((first * last).sum(1), 0.2, -0.8)[:, None]
    middle = unit(first + last - apart * DOWN + aside)
    begin, rest = (1 - share) ** 2 * first[:, None], share**2 * last[:, None]
    toward = unit(begin + 2 * share * (1 - share) * middle[:, None] + rest)
    near, far = (np.linalg.norm(ends - CENTRE, axis=1)[:, None, None] for ends in (start, end))
    return np.asarray(CENTRE + toward * (near + share * (far - near)), np.float32)


def _gathered(
    style: Style, roots: Roots, length: Float32, skin: Scalp, rng: np.random.Generator, parting: float | None
) -> Float32:
    """Guides that follow the head to their tie, and the tail behind it."""
    tie = _ties(style, roots, skin)
    share = np.linspace(0, 1, 24, dtype=np.float32)[None, :, None]
    aside = np.zeros((len(roots), 3), np.float32)
    if style.parting != "none" and style.gather not in LOOSE:
        front = smoothstep(np.abs(roots.azimuth), 1.3, 0.5) * smoothstep(roots.elevation, 0.2, 0.6)
        aside[:, 0] = PARTED * front * sides_of(style, roots, parting)
    way = _round_head(roots.position, tie, share, aside)
    rise = np.sin(np.pi * share[..., 0]) * style.volume_mm / 1000 * rng.uniform(0.4, 1, (len(roots), 1)) + 0.002
    for _ in range(6):  # out of the head, then straight: a taut thread on the skull
        way = skin.pushed(way, rise.astype(np.float32))
        way[:, 1:-1] = 0.25 * way[:, :-2] + 0.5 * way[:, 1:-1] + 0.25 * way[:, 2:]
        way[:, 0], way[:, -1] = roots.position, tie
    spread = rng.normal(0, 1, (len(roots), 3)).astype(np.float32)
    spread *= 0.006 / np.maximum(np.linalg.norm(spread, axis=1, keepdims=True), 1e-6)
    way = way + spread[:, None] * share**4
    used = length_of(way)
    left = np.maximum(length - used, 0.03)
    outward = unit(skin.outwards(tie))
    tail = _tail(style, way[:, -1], outward, spread, left, skin, rng)
    both = np.concatenate([way, tail], 1)
    return resampled(both, np.ones(len(both), np.float32), GUIDE_POINTS)


def _tail(
    style: Style,
    start: Float32,
    outward: Float32,
    spread: Float32,
    length: Float32,
    skin: Scalp,
    rng: np.random.Generator,
) -> Float32:
    """(N, 40, 3) what comes after the tie: hanging, wound to a bun, or plaited."""
    count, steps = len(start), 40
    share = np.linspace(0, 1, steps, dtype=np.float32)[None, :, None]
    if style.gather == "bun":
        size = float(np.clip(0.018 + 0.05 * float(np.median(length)), 0.02, 0.042))
        across = unit(np.cross(outward, DOWN + 1e-3))
        upward = np.cross(across, outward)
        centre = start - spread + outward * size * 0.8
        turn = rng.uniform(0, 2 * np.pi, (count, 1, 1)) + 2 * np.pi * share * rng.uniform(0.8, 1.6, (count, 1, 1))
        tube = rng.uniform(0, 2 * np.pi, (count, 1, 1)) + 1.5 * np.pi * share
        thick = size * 0.55 * np.sqrt(rng.uniform(0.2, 1, (count, 1, 1)))
        ring = (size * 0.75 + thick * np.cos(tube)) * np.minimum(1, 6 * share)
        point = centre[:, None] + ring * (np.cos(turn) * across[:, None] + np.sin(turn) * upward[:, None])
        return np.asarray(point + thick * np.sin(tube) * outward[:, None], np.float32)
    step = (length / steps)[:, None]
    heading, place, points = outward + 0.1 * spread / 0.006, start, []
    before = np.full(count, style.gather == "two_plaits")
    for k in range(steps):
        gone = k / steps * length[:, None]
        heading = heading + 0.5 * _draped(place, before)[:, None] * DEEP
        heading = unit(heading + (0.15 + 2.5 * style.gravity * np.clip(gone / 0.1, 0.1, 1)) * 0.35 * DOWN)
        tried = skin.pushed((place + step * heading).astype(np.float32), 0.006)
        heading = unit(tried - place)
        place = (place + step * heading).astype(np.float32)
        points.append(place)
    tail = np.stack(points, 1)
    if style.gather in ("plait", "two_plaits"):
        return _plaited(tail, spread, rng)
    body = spread[:, None] / 0.006 * 0.016 * np.sqrt(np.clip(np.sin(np.pi * np.clip(1.1 * share, 0, 1)), 0, 1))
    return np.asarray(tail + body * (1 - 0.4 * share), np.float32)


def _plaited(tail: Float32, spread: Float32, rng: np.random.Generator) -> Float32:
    """Three parts that cross in turn round the middle line of a tail (N, S, 3); each side of the head has its own."""
    made = tail.copy()
    for side in (tail[:, 0, 0] >= 0, tail[:, 0, 0] < 0) if np.abs(tail[:, 0, 0]).min() > 0.03 else (slice(None),):
        own = tail[side]
        if not len(own):
            continue
        middle = own.mean(0)
        along = unit(np.gradient(middle, axis=0))
        across = unit(np.cross(along, np.array([0.0, 0.3, 1.0], np.float32)))
        deep = np.cross(along, across)
        gone = gone_along(middle[None])[0]
        part = rng.integers(0, 3, len(own))
        phase = 2 * np.pi * (gone[None] / 0.055 + part[:, None] / 3)
        width = 0.011 * (1 - 0.5 * gone / max(float(gone[-1]), 1e-6))
        offset = width[None, :, None] * (
            np.sin(phase)[..., None] * across[None] + 0.5 * np.sin(2 * phase)[..., None] * deep[None]
        )
        made[side] = middle[None] + offset + spread[side][:, None] * 0.55
    return np.asarray(made, np.float32)


def resampled(lines: Float32, share: Float32, points: int) -> Float32:
    """Lines (N, P, 3) as ``points`` points each, evenly along the first ``share`` (N,) of their length."""
    gone = gone_along(lines)
    wanted = np.linspace(0, 1, points)[None] * (gone[:, -1] * share)[:, None]
    # All lines at once: each is shifted into a range of its own, so that one sorted search finds all places.
    reach = float(gone[:, -1].max(initial=0.0)) + 1.0
    base = reach * np.arange(len(lines))[:, None]
    place = np.searchsorted((gone + base).ravel(), (wanted + base).ravel(), side="right").reshape(wanted.shape)
    place = np.clip(place - np.arange(len(lines))[:, None] * lines.shape[1] - 1, 0, lines.shape[1] - 2)
    flat, start = lines.reshape(-1, 3), np.arange(len(lines))[:, None] * lines.shape[1] + place
    before = gone.take(start)
    part = np.clip((wanted - before) / np.maximum(gone.take(start + 1) - before, 1e-12), 0, 1)[..., None]
    return np.asarray(flat.take(start, 0) * (1 - part) + flat.take(start + 1, 0) * part, np.float32)
