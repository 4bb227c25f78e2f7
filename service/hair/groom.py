"""Strands of a style on a head: guides are grown, then thousands of strands are laid between them.

::

    Style, Scalp --roots--> Roots --grow or gather--> guides (G, 32, 3)
    guides --interpolate, clump, curl, frizz--> strands (N, P, 3)

The way of procedural grooms in production (Yuksel et al. 2009, "Hair Meshes", section 2; DiffLocks 2025, section 3).
All lengths are metres in the head's frame: +X the subject's left, +Y up, +Z forward, origin between the eyes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from service.arrays import AnyFloat, Bool, Float32, Int32, Int64
from service.hair.colour import HairColour
from service.hair.scalp import CROWN, SHOULDERS, Roots, Scalp, mean_scalp
from service.hair.style import WAVES, Style

GUIDES, GUIDE_POINTS = 600, 32
NEAR_GUIDES = 3
"""Guides that a strand lies between."""
DEEP = np.array([0.0, 0.0, 1.0], np.float32)
DOWN = np.array([0.0, -1.0, 0.0], np.float32)
SHOVED_M = 0.01
"""Most by which a finished strand is moved out of the body; its guides were led round it."""
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
SIDES_RAD = 0.85
"""Azimuth at which front becomes side; side becomes back at pi minus it."""
POINTS_PER_TURN = 8
"""Points that a curl needs to look round."""
MOST_POINTS = 128


@dataclass(frozen=True)
class Groom:
    """Strands.

    Attributes:
        style: what was asked for.
        strands: (N, P, 3) float32 metres in the frame of the head at rest, root first.
        root_uv: (N, 2) float32 in [0, 1], place of the roots on the head's chart, origin bottom left.
        lock: (N,) int32 number of the lock that a strand belongs to.
        guide: (N,) int32 index of the guide that is nearest to a strand's root.
        guides: (G, 32, 3) float32 metres.
        colour: of the strands.
    """

    style: Style
    strands: Float32
    root_uv: Float32
    lock: Int32
    guide: Int32
    guides: Float32
    colour: HairColour

    def __len__(self) -> int:
        return len(self.strands)


def make_groom(style: Style, seed: int, strands: int = 10_000, scalp: Scalp | None = None) -> Groom:
    """Groom a head.

    Args:
        style: what to groom.
        seed: of all that is random.
        strands: of a full head; ``style.density``, receding and bald parts have fewer.
        scalp: of the head; None for the mean head.

    Raises:
        ValueError: fewer than one strand is asked for.
    """
    if strands < 1:
        raise ValueError(f"strands is {strands}; at least 1 has to be asked for")
    skin, rng = mean_scalp() if scalp is None else scalp, np.random.default_rng([seed, 0x6A1])
    guide_roots = _thinned(_grown(skin.roots(6 * GUIDES, rng), style, rng), GUIDES)
    roots = _grown(skin.roots(strands, rng), style, rng)
    roots = roots.chosen(rng.random(len(roots)) < style.density)
    if not len(guide_roots) or not len(roots):
        none, number = np.zeros((0, GUIDE_POINTS, 3), np.float32), np.zeros(0, np.int32)
        colour = HairColour.of(style.melanin, 0, rng)
        return Groom(style, none, none[:, 0, :2], number, number, none, colour)
    guides = grow_guides(style, guide_roots, skin, rng)
    points, lock, guide = _between(style, guide_roots, guides, roots, rng)
    points = _curled(style, points, lock, rng)
    points = _wandering(style, points, rng)
    inner = skin.pushed(points[:, 1:], CLEARANCE_M, SHOVED_M)
    points = np.concatenate([points[:, :1], inner], 1).astype(np.float32)
    return Groom(style, points, roots.uv, lock, guide, guides, HairColour.of(style.melanin, len(points), rng))


def _grown(roots: Roots, style: Style, rng: np.random.Generator) -> Roots:
    """Roots that this style's hairline, temples and crown leave."""
    azimuth, elevation = roots.azimuth, roots.elevation
    temples = np.exp(-np.square((np.abs(azimuth) - 0.62) / 0.3) - np.square((elevation - 0.72) / 0.38))
    forehead = np.exp(-np.square(azimuth / 0.5) - np.square((elevation - 0.8) / 0.25))
    crown = np.exp(-np.square(np.linalg.norm(roots.position - CROWN, axis=1) / (0.02 + 0.045 * style.crown)))
    phase = rng.uniform(0, 2 * np.pi, 3)
    wander = sum(np.sin(k * azimuth + p) / k for k, p in zip((3, 5, 9), phase, strict=True))
    keep = roots.edge + style.hairline * (0.15 * wander - 0.1)
    keep = keep - style.receding * (1.8 * temples + 0.7 * forehead) - style.crown * 1.6 * crown
    return roots.chosen(keep > rng.uniform(-0.02, 0.22, len(roots)))


def _thinned(roots: Roots, count: int) -> Roots:
    """At most ``count`` roots, spread evenly: the farthest first (Gonzalez 1985)."""
    if len(roots) <= count:
        return roots
    chosen = np.zeros(count, np.int64)
    apart = np.full(len(roots), np.inf, np.float32)
    for i in range(1, count):
        apart = np.minimum(apart, np.square(roots.position - roots.position[chosen[i - 1]]).sum(1))
        chosen[i] = int(apart.argmax())
    return roots.chosen(chosen)


def lengths(style: Style, roots: Roots, rng: np.random.Generator) -> Float32:
    """(N,) metres of each strand by where it grows."""
    front = _step(SIDES_RAD + 0.25, SIDES_RAD - 0.25, np.abs(roots.azimuth))
    back = _step(np.pi - SIDES_RAD - 0.3, np.pi - SIDES_RAD + 0.3, np.abs(roots.azimuth))
    high = _step(0.45, 0.95, roots.elevation)
    around = back * style.back_mm + (1 - back) * style.sides_mm
    low_front = front * (1 - _step(0.85, 1.1, roots.elevation))
    length = high * style.top_mm + (1 - high) * around
    length = low_front * style.fringe_mm + (1 - low_front) * length
    if style.fade > 0:  # clipped from the nape and the sides upwards
        clipped = 1 - _step(style.fade * 1.1 - 0.25, style.fade * 1.1 + 0.15, roots.elevation + 0.25)
        length = length * (1 - clipped * (1 - front)) + 2.0 * clipped * (1 - front)
    uneven = 1 + 0.05 * rng.normal(0, 1, len(roots))
    return (length * np.clip(uneven, 0.7, 1.3) / 1000).astype(np.float32)


def _fringe(roots: Roots) -> Bool:
    """(N,) what grows over the forehead."""
    return np.asarray((np.abs(roots.azimuth) < SIDES_RAD) & (roots.elevation < 1.0))


def _forward(roots: Roots) -> Bool:
    """(N,) what falls before the shoulders where it is long enough; the rest falls behind them."""
    return np.asarray(np.abs(roots.azimuth) < 1.35)


def _groups(style: Style, roots: Roots) -> Int64:
    """(N,) number of the part of the hair that a strand belongs to: strands are not blended across these borders."""
    split = style.parting != "none" or style.combing in ("side", "down") or style.gather in ("pinned", "two_plaits")
    longest = max(style.top_mm, style.sides_mm, style.back_mm)
    parts = (
        (sides_of(style, roots) > 0) & split,
        _tied(style, roots) & (style.gather != "none"),
        _forward(roots) & (longest > 200) & (style.gather in ("none", "half_up", "pinned")),
        _fringe(roots) & (style.fringe_mm < 0.6 * style.top_mm),
    )
    return sum((part.astype(np.int64) << bit for bit, part in enumerate(parts)), np.zeros(len(roots), np.int64))


def combed(style: Style, points: Float32, outwards: Float32, side: Float32) -> Float32:
    """(N, 3) unit directions along the skin in which hair at these points is combed.

    Args:
        style: how.
        points: (N, 3) metres.
        outwards: (N, 3) unit normals of the body there.
        side: (N,) +1 or -1: on which side of the parting the strand grows.
    """
    from_crown = points - CROWN
    ahead, up = np.array([0, 0, 1], np.float32), np.array([0, 1, 0], np.float32)
    swirl = np.cross(outwards, from_crown)
    natural = from_crown + 0.5 * swirl
    # On the whorl itself all directions meet; there hair lies backwards, as it does on most heads.
    natural = natural - 0.03 * np.exp(-np.square(np.linalg.norm(from_crown, axis=1, keepdims=True) / 0.03)) * ahead
    natural /= np.maximum(np.linalg.norm(natural, axis=1, keepdims=True), 1e-6)
    sideways = side[:, None] * np.array([1, 0, 0], np.float32)
    front = _step(-0.09, -0.02, points[:, 2])[:, None]
    wish = {
        "natural": natural + 0.3 * DOWN,
        "down": front * (1.3 * sideways - 0.25 * ahead + 0.4 * DOWN) + (1 - front) * (natural + DOWN),
        "back": -ahead + 0.25 * up * front + 0.35 * DOWN * (1 - front),
        "forward": natural + 0.9 * ahead,
        "side": front * (sideways * 1.2 + 0.35 * ahead) + (1 - front) * (natural + 0.5 * DOWN),
        "up": 0.6 * outwards + natural * 0.3 + 0.2 * ahead * front,
    }[style.combing]
    if style.parting != "none" and style.combing in ("natural", "forward"):
        wish = wish + 0.8 * front * sideways
    along = wish - outwards * (wish * outwards).sum(1, keepdims=True) * (style.combing != "up")
    return _unit(along)


PARTINGS_M = {"none": 0.0, "middle": 0.0, "left": 0.028, "right": -0.028}
"""Where a parting lies, metres to the subject's left."""


def _from_parting(style: Style, roots: Roots) -> Float32:
    """(N,) metres to the parting."""
    return np.asarray(np.abs(roots.position[:, 0] - PARTINGS_M[style.parting]), np.float32)


def sides_of(style: Style, roots: Roots) -> Float32:
    """(N,) +1 where a strand falls to the subject's left of the parting, -1 to its right."""
    at = PARTINGS_M[style.parting]
    if style.combing == "side" and style.parting in ("none", "middle"):
        at = 0.04  # all to one side but what grows over that ear
    return np.where(roots.position[:, 0] >= at, 1.0, -1.0).astype(np.float32)


def grow_guides(style: Style, roots: Roots, skin: Scalp, rng: np.random.Generator) -> Float32:
    """(G, 32, 3) guides from their roots: combed, lifted, bent by their weight, gathered where that is asked for."""
    length = lengths(style, roots, rng)
    free = np.ones(len(roots), bool)
    guides = np.zeros((len(roots), GUIDE_POINTS, 3), np.float32)
    if style.gather != "none":
        free = ~_tied(style, roots)
        if (~free).any():
            guides[~free] = _gathered(style, roots.chosen(~free), length[~free], skin, rng)
    if free.any():
        guides[free] = _hanging(style, roots.chosen(free), length[free], skin, rng)
    return guides


def _hanging(style: Style, roots: Roots, length: Float32, skin: Scalp, rng: np.random.Generator) -> Float32:
    side = sides_of(style, roots)
    step = (length / (GUIDE_POINTS - 1))[:, None]
    # Hair from higher up lies over hair from below, so the body of hair gets its thickness.
    layer = 0.25 + 0.75 * _step(-0.6, 1.2, roots.elevation)
    layer = (layer * rng.uniform(0.5, 1.0, len(roots))).astype(np.float32)
    place = roots.position
    comb = combed(style, place, roots.normal, side)
    parted = 0.35 * np.exp(-np.square(_from_parting(style, roots) / 0.012)) if style.parting != "none" else 0.0
    rising = np.clip(style.lift + parted, 0, 1)[..., None] if style.parting != "none" else style.lift
    heading = _unit(rising * roots.normal + (1.02 - rising) * comb)
    points = [place]
    long = _step(0.09, 0.14, length)[:, None]
    before = _forward(roots)
    astray = rng.normal(0, 0.7, (len(roots), 3)).astype(np.float32) * np.exp(
        -np.square(np.linalg.norm(place - CROWN, axis=1, keepdims=True) / 0.035)
    )
    heading = _unit(heading + astray)
    for k in range(1, GUIDE_POINTS):
        gone = np.minimum(k * step, 1.0)
        outwards = skin.outwards(place)
        comb = combed(style, place, outwards, side) * np.exp(-gone / COMBED_M)
        weight = style.gravity * np.clip(gone / HANGS_AFTER_M, 0, 1.5)
        bent = (0.4 + 1.6 * style.stiffness) * heading + 0.5 * (1 - style.lift) * comb + weight * DOWN
        aside = long * _before_face(place)[:, None] * side[:, None] * ASIDE
        heading = _unit(bent + aside + _draped(place, before)[:, None] * DEEP)
        rise = np.minimum(gone[:, 0] * 0.6, style.volume_mm / 1000 * layer) + CLEARANCE_M
        tried = skin.pushed((place + step * heading).astype(np.float32), rise.astype(np.float32))
        heading = _unit(tried - place)
        place = np.asarray(place + step * heading, np.float32)
        points.append(place)
    guides = np.stack(points, 1)
    return _cut(style, guides, rng) if style.cut_y is not None else guides


def _draped(points: Float32, before: Bool) -> Float32:
    """(N,) how far forward (negative: back) hair below the ears is drawn: it falls before or behind the shoulders."""
    middle, radii = SHOULDERS
    wanted = np.where(before, middle[2] + radii[2] + 0.02, middle[2] - radii[2] - 0.015)
    low = _step(-0.03, -0.11, points[:, 1])
    return np.asarray(low * np.clip((wanted - points[:, 2]) / 0.04, -1.2, 1.2), np.float32)


def _before_face(points: Float32) -> Float32:
    """(N,) 1 before the middle of the face, 0 beside it: nobody wears long hair there."""
    across = 1 - _step(0.035, 0.062, np.abs(points[:, 0]))
    return across * _step(-0.03, 0.0, points[:, 2]) * (1 - _step(0.04, 0.075, points[:, 1]))


def _cut(style: Style, guides: Float32, rng: np.random.Generator) -> Float32:
    """Guides that end where they first fall below the height of the cut; the rest keep their length."""
    if style.cut_y is None:
        return guides
    reach = -style.cut_y + 0.05
    height = style.cut_y + rng.normal(0, CUT_SPREAD_M, len(guides))
    height = height + style.layers * reach * 0.33 * rng.random(len(guides))
    below = guides[..., 1] < height[:, None]
    first = np.where(below.any(1), below.argmax(1), GUIDE_POINTS - 1)
    ends = np.clip(first, 2, GUIDE_POINTS - 1).astype(np.float32)
    return _resampled(guides, np.asarray(ends / (GUIDE_POINTS - 1), np.float32), GUIDE_POINTS)


def _tied(style: Style, roots: Roots) -> Bool:
    """(N,) whether strands reach the tie: all, the upper ones of a half-up, the front ones where it is pinned back."""
    if style.gather == "half_up":
        return np.asarray(roots.elevation > 0.35)
    if style.gather == "pinned":
        return np.asarray((np.abs(roots.azimuth) < 1.5) & (roots.elevation > 0.0))
    return np.ones(len(roots), bool)


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


def _gathered(style: Style, roots: Roots, length: Float32, skin: Scalp, rng: np.random.Generator) -> Float32:
    """Guides that follow the head to their tie, and the tail behind it."""
    tie = _ties(style, roots, skin)
    share = np.linspace(0, 1, 24, dtype=np.float32)[None, :, None]
    way = roots.position[:, None] + share * (tie - roots.position)[:, None]
    rise = np.sin(np.pi * share[..., 0]) * style.volume_mm / 1000 * rng.uniform(0.4, 1, (len(roots), 1)) + 0.002
    for _ in range(6):  # out of the head, then straight: a taut thread on the skull
        way = skin.pushed(way, rise.astype(np.float32))
        way[:, 1:-1] = 0.25 * way[:, :-2] + 0.5 * way[:, 1:-1] + 0.25 * way[:, 2:]
        way[:, 0], way[:, -1] = roots.position, tie
    spread = rng.normal(0, 1, (len(roots), 3)).astype(np.float32)
    spread *= 0.006 / np.maximum(np.linalg.norm(spread, axis=1, keepdims=True), 1e-6)
    way = way + spread[:, None] * share**4
    used = np.linalg.norm(np.diff(way, axis=1), axis=2).sum(1)
    left = np.maximum(length - used, 0.03)
    outward = _unit(skin.outwards(tie))
    tail = _tail(style, way[:, -1], outward, spread, left, skin, rng)
    both = np.concatenate([way, tail], 1)
    return _resampled(both, np.ones(len(both), np.float32), GUIDE_POINTS)


def _tail(
    style: Style, start: Float32, outward: Float32, spread: Float32, length: Float32, skin: Scalp,
    rng: np.random.Generator,
) -> Float32:
    """(N, 40, 3) what comes after the tie: hanging, wound to a bun, or plaited."""
    count, steps = len(start), 40
    share = np.linspace(0, 1, steps, dtype=np.float32)[None, :, None]
    if style.gather == "bun":
        size = float(np.clip(0.018 + 0.05 * float(np.median(length)), 0.02, 0.042))
        across = _unit(np.cross(outward, DOWN + 1e-3))
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
        heading = _unit(heading + (0.15 + 2.5 * style.gravity * np.clip(gone / 0.1, 0.1, 1)) * 0.35 * DOWN)
        tried = skin.pushed((place + step * heading).astype(np.float32), 0.006)
        heading = _unit(tried - place)
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
        along = _unit(np.gradient(middle, axis=0))
        across = _unit(np.cross(along, np.array([0.0, 0.3, 1.0], np.float32)))
        deep = np.cross(along, across)
        gone = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
        part = rng.integers(0, 3, len(own))
        phase = 2 * np.pi * (gone[None] / 0.055 + part[:, None] / 3)
        width = 0.011 * (1 - 0.5 * gone / max(float(gone[-1]), 1e-6))
        offset = width[None, :, None] * (
            np.sin(phase)[..., None] * across[None] + 0.5 * np.sin(2 * phase)[..., None] * deep[None]
        )
        made[side] = middle[None] + offset + spread[side][:, None] * 0.55
    return np.asarray(made, np.float32)


def _between(
    style: Style, guide_roots: Roots, guides: Float32, roots: Roots, rng: np.random.Generator
) -> tuple[Float32, Int32, Int32]:
    """Strands (N, P, 3) as blends of near guides, drawn together in locks; each strand's lock and nearest guide.

    A strand keeps to guides of its own part of the hair (:func:`_groups`).
    """
    group, own_group = _groups(style, guide_roots), _groups(style, roots)
    index = np.zeros((len(roots), NEAR_GUIDES), np.int64)
    apart = np.zeros((len(roots), NEAR_GUIDES), np.float32)
    for value in np.unique(own_group):
        own, of = own_group == value, np.flatnonzero(group == value)
        of = of if len(of) else np.arange(len(guides))
        found = cKDTree(guide_roots.position[of]).query(roots.position[own], k=min(NEAR_GUIDES, len(of)))
        distance, nearest = (np.asarray(part).reshape(int(own.sum()), -1) for part in found)
        fill = NEAR_GUIDES - nearest.shape[1]
        index[own] = of[np.pad(nearest, ((0, 0), (0, fill)), mode="edge")]
        apart[own] = np.pad(distance, ((0, 0), (0, fill)), mode="edge")
    weight = 1 / np.maximum(apart, 1e-4)
    weight /= weight.sum(1, keepdims=True)
    points = _points(style, float(np.median(np.linalg.norm(np.diff(guides, axis=1), axis=2).sum(1))))
    fine = _resampled(guides, np.ones(len(guides), np.float32), points)
    offset = fine - fine[:, :1]
    strands = roots.position[:, None] + sum(weight[:, k, None, None] * offset[index[:, k]] for k in range(NEAR_GUIDES))
    # A lock gathers round one of its strands, from the root's place to its tip.
    count = max(1, min(len(roots), round(0.055 / (style.lock_mm / 1000) ** 2)))
    heads = _thinned(roots, count) if len(roots) <= 4000 else roots.chosen(rng.choice(len(roots), count, replace=False))
    tree = cKDTree(np.column_stack([heads.position, 0.05 * _groups(style, heads)[:, None]]))
    lock = tree.query(np.column_stack([roots.position, 0.05 * own_group[:, None]]))[1].astype(np.int32)
    middle = np.zeros((len(heads.position), points, 3), np.float32)
    size = np.bincount(lock, minlength=len(middle)).astype(np.float32)
    for axis in range(3):
        for p in range(points):
            middle[:, p, axis] = np.bincount(lock, strands[:, p, axis], len(middle))
    middle /= np.maximum(size, 1)[:, None, None]
    share = np.linspace(0, 1, points, dtype=np.float32)
    hold = (style.clump * share**0.8)[None] * np.where(rng.random(len(roots)) < style.flyaways, 0, 1)[:, None]
    strands = strands + hold[..., None] * (middle[lock] - strands)
    trim = rng.uniform(0.90, 1.0, len(roots)).astype(np.float32)
    return _resampled(np.asarray(strands, np.float32), trim, points), lock, index[:, 0].astype(np.int32)


def _points(style: Style, length: float) -> int:
    """Points of a finished strand: enough for its curls."""
    wave = WAVES[style.curl]
    turns = length * 1000 / wave.pitch_mm if wave.radius_mm else 0.0
    return int(np.clip(POINTS_PER_TURN * turns, 16 if length < 0.05 else GUIDE_POINTS, MOST_POINTS))


def _curled(style: Style, strands: Float32, lock: Int32, rng: np.random.Generator) -> Float32:
    """Strands wound round their own middle line: a wave, curl or coil whose phase the strands of a lock share."""
    wave = WAVES[style.curl]
    if wave.radius_mm == 0 or strands.shape[1] < 3:
        return strands
    along = _unit(np.gradient(strands, axis=1))
    across = _unit(np.cross(along, np.array([0.13, 0.31, 0.94], np.float32)))
    deep = np.cross(along, across)
    turn = rng.uniform(0, 2 * np.pi, int(lock.max()) + 1)[lock][:, None, None].astype(np.float32)
    across, deep = (
        np.asarray(np.cos(turn) * across + np.sin(turn) * deep, np.float32),
        np.asarray(np.cos(turn) * deep - np.sin(turn) * across, np.float32),
    )
    gone = np.concatenate(
        [np.zeros((len(strands), 1)), np.cumsum(np.linalg.norm(np.diff(strands, axis=1), axis=2), axis=1)], 1
    )
    locks = int(lock.max()) + 1
    pitch = wave.pitch_mm / 1000 * np.exp(rng.normal(0, 0.12, locks))[lock]
    # No more turns than the points can draw.
    longest = np.maximum(gone[:, -1], 1e-6)
    pitch = np.maximum(pitch, longest / (strands.shape[1] / 5))
    hand = rng.choice([-1.0, 1.0], locks)[lock]
    phase = rng.uniform(0, 2 * np.pi, locks)[lock] + (0.25 + 2 * wave.frizz) * rng.normal(0, 1, len(lock))
    # No curl is even: its turns are now wider, now closer.
    drift = np.cumsum(rng.normal(0, 1, (locks, strands.shape[1])), 1)[lock] / np.sqrt(strands.shape[1])
    angle = (2 * np.pi * gone / pitch[:, None] + phase[:, None] + 1.8 * drift) * hand[:, None]
    begin = np.clip(gone / np.maximum(0.5 * pitch, 0.006)[:, None], 0, 1)
    radius = wave.radius_mm / 1000 * np.exp(rng.normal(0, 0.15 + 0.4 * wave.frizz, len(lock)))
    radius = np.minimum(radius[:, None], 0.25 * longest[:, None]) * begin
    turned = np.cos(angle)[..., None] * across + (1 - wave.flat) * np.sin(angle)[..., None] * deep
    return np.asarray((strands + radius[..., None] * turned), np.float32)


def _wandering(style: Style, strands: Float32, rng: np.random.Generator) -> Float32:
    """Strands with a smooth wander of their own, more towards the tip, and most where they have left their lock."""
    count, points = strands.shape[:2]
    knots = rng.normal(0, 1, (count, 6, 3)).astype(np.float32)
    at = np.linspace(0, 5, points)
    low = np.minimum(at.astype(int), 4)
    part = (at - low)[None, :, None]
    smooth = part * part * (3 - 2 * part)
    noise = knots[:, low] * (1 - smooth) + knots[:, low + 1] * smooth
    noise -= noise[:, :1]
    size = style.frizz_mm / 1000 * np.where(rng.random(count) < style.flyaways, 4.0, 1.0)
    length = np.linalg.norm(np.diff(strands, axis=1), axis=2).sum(1)
    size = np.minimum(size, 0.1 * length)
    share = np.linspace(0, 1, points, dtype=np.float32)
    return np.asarray((strands + size[:, None, None] * share[None, :, None] * noise), np.float32)


def _resampled(lines: Float32, share: Float32, points: int) -> Float32:
    """Lines (N, P, 3) as ``points`` points each, evenly along the first ``share`` (N,) of their length."""
    steps = np.linalg.norm(np.diff(lines, axis=1), axis=2)
    gone = np.concatenate([np.zeros((len(lines), 1)), np.cumsum(steps, 1)], 1)
    wanted = np.linspace(0, 1, points)[None] * (gone[:, -1] * share)[:, None]
    # All lines at once: each is shifted into a range of its own, so that one sorted search finds all places.
    reach = float(gone[:, -1].max(initial=0.0)) + 1.0
    base = reach * np.arange(len(lines))[:, None]
    place = np.searchsorted((gone + base).ravel(), (wanted + base).ravel(), side="right").reshape(wanted.shape)
    place = np.clip(place - np.arange(len(lines))[:, None] * lines.shape[1] - 1, 0, lines.shape[1] - 2)
    row = np.arange(len(lines))[:, None]
    run = np.maximum(gone[row, place + 1] - gone[row, place], 1e-12)
    part = np.clip((wanted - gone[row, place]) / run, 0, 1)[..., None]
    return np.asarray((lines[row, place] * (1 - part) + lines[row, place + 1] * part), np.float32)


def _step(low: float, high: float, value: Float32) -> Float32:
    """0 up to ``low``, 1 from ``high`` on, smooth between; ``low`` may be the larger."""
    share = np.clip((value - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share), np.float32)


def _unit(vectors: AnyFloat) -> Float32:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9), np.float32)
