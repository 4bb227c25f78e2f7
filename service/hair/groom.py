"""Strands of a style on a head: guides are grown, then thousands of strands are laid between them.

::

    Style, Scalp --roots--> Roots --grow or gather--> guides (G, 32, 3)
    guides --interpolate, clump, curl, frizz--> strands (N, P, 3)

The way of procedural grooms in production (Yuksel et al. 2009, "Hair Meshes", section 2; DiffLocks 2025, section 3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Bool, Float32, Int32, Int64
from service.geometry.mesh import unit
from service.geometry.nearest import Nearest
from service.hair.colour import HairColour
from service.hair.guides import (
    CLEARANCE_M,
    GUIDE_POINTS,
    GUIDES,
    Combing,
    groups,
    grow_several,
    grown,
    resampled,
    seen_parting,
)
from service.hair.scalp import Roots, Scalp, gone_along, length_of, mean_scalp
from service.hair.style import WAVES, Style

NEAR_GUIDES = 3
"""Guides that a strand lies between."""
SHOVED_M = 0.01
"""Most by which a finished strand is moved out of the body; its guides were led round it."""
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
        colour: of the strands.
    """

    style: Style
    strands: Float32
    root_uv: Float32
    lock: Int32
    colour: HairColour

    def __len__(self) -> int:
        return len(self.strands)

    def chosen(self, strands: Float32, kept: Bool | Int64) -> Groom:
        """Those of a mask (N,) or an index (M,), with points (M, P, 3) in the place of theirs."""
        return replace(
            self, strands=np.asarray(strands, np.float32), root_uv=self.root_uv[kept], lock=self.lock[kept],
            colour=self.colour.chosen(kept),
        )  # fmt: skip

    def joined(self, strands: Float32, root_uv: Float32, like: Int64) -> Groom:
        """With more strands (M, P, 3), whose lock and colour are those of the strands (M,) ``like``."""
        index = np.concatenate([np.arange(len(self)), like])
        whole = self.chosen(self.strands[index], index)
        return replace(
            whole, strands=np.concatenate([self.strands, strands.astype(np.float32)]),
            root_uv=np.concatenate([self.root_uv, root_uv]),
        )  # fmt: skip


def make_groom(
    style: Style, seed: int, strands: int = 10_000, scalp: Scalp | None = None, wish: Combing | None = None
) -> Groom:
    """Groom a head.

    Args:
        style: what to groom.
        seed: of all that is random.
        strands: of a full head; ``style.density``, receding and bald parts have fewer.
        scalp: of the head; None for the mean head.
        wish: combing that goes before the style's where it is sure.

    Raises:
        ValueError: fewer than one strand is asked for.
    """
    if strands < 1:
        raise ValueError(f"strands is {strands}; at least 1 has to be asked for")
    skin, rng = mean_scalp() if scalp is None else scalp, np.random.default_rng([seed, 0x6A1])
    guide_roots = grown(skin.even.chosen(np.arange(GUIDES)), style, rng)
    roots = grown(skin.roots(strands, rng), style, rng)
    roots = roots.chosen(rng.random(len(roots)) < style.density)
    if not len(guide_roots) or not len(roots):
        none, colour = np.zeros((0, GUIDE_POINTS, 3), np.float32), HairColour.of(style.melanin, 0, rng)
        return Groom(style, none, none[:, 0, :2], np.zeros(0, np.int32), colour)
    parting = seen_parting(style, guide_roots, wish)
    [guides] = grow_several([(style, guide_roots, rng)], skin, wish, parting)
    points, lock = _between(style, guide_roots, guides, roots, skin, rng, parting)
    points = _curled(style, points, lock, rng)
    points = wandering(style, points, rng)
    inner = skin.over_ears.pushed(points[:, 1:], CLEARANCE_M, SHOVED_M)
    points = np.concatenate([points[:, :1], inner], 1).astype(np.float32)
    return Groom(style, points, roots.uv, lock, HairColour.of(style.melanin, len(points), rng))


def _between(
    style: Style, guide_roots: Roots, guides: Float32, roots: Roots, skin: Scalp, rng: np.random.Generator,
    parting: float | None,
) -> tuple[Float32, Int32]:  # fmt: skip
    """Strands (N, P, 3) as blends of near guides, drawn together in locks; and each strand's lock.

    A strand keeps to guides of its own part of the hair (:func:`groups`).
    """
    group, own_group = groups(style, guide_roots, parting), groups(style, roots, parting)
    index = np.zeros((len(roots), NEAR_GUIDES), np.int64)
    apart = np.zeros((len(roots), NEAR_GUIDES), np.float32)
    for value in np.unique(own_group):
        own, of = own_group == value, np.flatnonzero(group == value)
        of = of if len(of) else np.arange(len(guides))
        distance, nearest = Nearest(guide_roots.position[of])(roots.position[own], NEAR_GUIDES)
        fill = NEAR_GUIDES - nearest.shape[1]
        index[own] = of[np.pad(nearest, ((0, 0), (0, fill)), mode="edge")]
        apart[own] = np.pad(distance, ((0, 0), (0, fill)), mode="edge")
    weight = 1 / np.maximum(apart, 1e-4)
    weight /= weight.sum(1, keepdims=True)
    points = _points(style, float(np.median(length_of(guides))))
    fine = resampled(guides, np.ones(len(guides), np.float32), points)
    offset = fine - fine[:, :1]
    strands = roots.position[:, None] + sum(weight[:, k, None, None] * offset[index[:, k]] for k in range(NEAR_GUIDES))
    # A lock gathers round one of its strands, from the root's place to its tip.
    count = max(1, min(len(roots), round(0.055 / (style.lock_mm / 1000) ** 2)))
    even = count <= len(skin.even)
    heads = skin.even.chosen(np.arange(count)) if even else roots.chosen(rng.choice(len(roots), count, replace=False))
    tree = Nearest(np.column_stack([heads.position, 0.05 * groups(style, heads, parting)[:, None]]))
    lock = tree.one(np.column_stack([roots.position, 0.05 * own_group[:, None]]))[1].astype(np.int32)
    middle = np.zeros((len(heads.position), points, 3), np.float32)
    size = np.bincount(lock, minlength=len(middle)).astype(np.float32)
    for axis in range(3):
        for p in range(points):
            middle[:, p, axis] = np.bincount(lock, strands[:, p, axis], len(middle))
    middle /= np.maximum(size, 1)[:, None, None]
    share = np.linspace(0, 1, points, dtype=np.float32)
    # A lock thins towards its end and never becomes a thread; where all of it is pressed to the head it lies flat.
    pressed = 0.3 if style.gather != "none" else 0.85
    hold = (pressed * style.clump * share**1.3)[None] * np.where(rng.random(len(roots)) < style.flyaways, 0, 1)[:, None]
    strands = strands + hold[..., None] * (middle[lock] - strands)
    trim = rng.uniform(0.90, 1.0, len(roots)).astype(np.float32)
    return resampled(np.asarray(strands, np.float32), trim, points), lock


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
    along = unit(np.gradient(strands, axis=1))
    across = unit(np.cross(along, np.array([0.13, 0.31, 0.94], np.float32)))
    deep = np.cross(along, across)
    locks = int(lock.max()) + 1
    turn = rng.uniform(0, 2 * np.pi, locks)[lock][:, None, None].astype(np.float32)
    across, deep = (
        np.asarray(np.cos(turn) * across + np.sin(turn) * deep, np.float32),
        np.asarray(np.cos(turn) * deep - np.sin(turn) * across, np.float32),
    )
    gone = gone_along(strands)
    pitch = wave.pitch_mm / 1000 * np.exp(rng.normal(0, 0.12, locks))[lock]
    # No more turns than the points can draw.
    longest = np.maximum(gone[:, -1], 1e-6)
    pitch = np.maximum(pitch, longest / (strands.shape[1] / 5))
    hand = rng.choice([-1.0, 1.0], locks)[lock]
    phase = rng.uniform(0, 2 * np.pi, locks)[lock] + (0.25 + 2 * wave.frizz) * rng.normal(0, 1, len(lock))
    # No curl is even: its turns are now wider, now closer.
    drift = np.cumsum(rng.normal(0, 1, (locks, strands.shape[1])), 1)[lock] / np.sqrt(strands.shape[1])
    angle = (2 * np.pi * gone / pitch[:, None] + phase[:, None] + 1.8 * drift) * hand[:, None]
    straight = wave.begins * longest
    begin = np.clip((gone - straight[:, None]) / np.maximum(np.maximum(0.5 * pitch, 0.006), straight)[:, None], 0, 1)
    radius = wave.radius_mm / 1000 * np.exp(rng.normal(0, 0.15 + 0.4 * wave.frizz, len(lock)))
    radius = np.minimum(radius[:, None], 0.25 * longest[:, None]) * begin
    turned = np.cos(angle)[..., None] * across + (1 - wave.flat) * np.sin(angle)[..., None] * deep
    return np.asarray((strands + radius[..., None] * turned), np.float32)


def wandering(style: Style, strands: Float32, rng: np.random.Generator) -> Float32:
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
    length = length_of(strands)
    size = np.minimum(size, 0.1 * length)
    share = np.linspace(0, 1, points, dtype=np.float32)
    return np.asarray((strands + size[:, None, None] * share[None, :, None] * noise), np.float32)
