"""One photo with all rules, without each, and without any: what each changed, gained and took."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.corrections.kept import Kept
from benchmarks.corrections.rules import FIRST_STAGE, RELIEF, Rule, Rules
from benchmarks.corrections.score import Score
from service.archive.avatar import Avatar
from service.colour import FULL_CODE
from service.geometry.chart import islands
from service.reflectance.reflectance_maps import NORMAL_ONE
from service.texture.texture_maps import SEEN

Codes = npt.NDArray[np.uint16]
Map = npt.NDArray[np.float32]

ALL = "all of these"
"""Name of the variant without any rule."""
REPEATS = 2
"""Times that the whole is made with all rules; its time is their median."""
STEP = FULL_CODE // 255
"""Codes of 1/255."""
NORMAL_STEP = 2 * NORMAL_ONE / 255
"""The same of a component of normals in [-1, 1]."""


class Scorer(Protocol):
    """Scores albedos of one fitted photo; ``benchmarks.corrections.score.Judge``."""

    def score(self, albedo: Map) -> Score:
        """Of a map (h, w, 3) on the chart, sRGB-coded in [0, 1]."""

    def flat(self) -> Score:
        """Of one colour all over, the true mean."""

    def relief(self, avatar: Avatar) -> float:
        """PSNR in dB of an avatar's specular normals."""


@dataclass(frozen=True)
class Effect:
    """What one rule does to one photo, as the difference to the photo without it.

    Attributes:
        changed, changed_seen: share of the skin's texels, and of those that the photo shows, whose albedo the rule
            changes by more than 1/255 in any channel.
        seconds: that the rule takes of a processor; NaN where it had nothing to do and was not run without.
        whole_seconds: that the stages which were made anew take with it; NaN likewise.
        gain: what the rule makes better; None without truth. Of a rule for relief ``best`` is the gain of the specular
            normals, and the rest is NaN; what it changes are their codes.
    """

    changed: float
    changed_seen: float
    seconds: float
    whole_seconds: float
    gain: Score | None


@dataclass(frozen=True)
class Verdicts:
    """Of one photo.

    Attributes:
        photo, groups: its name and what it has.
        score, flat: with all rules, and of the one colour that is the mean of the true ones; None without truth.
        effects: by rule, and of all together as ``ALL``.
        warnings: of the avatar.
    """

    photo: str
    groups: tuple[str, ...]
    score: Score | None
    flat: Score | None
    effects: dict[str, Effect]
    warnings: tuple[str, ...] = ()


def tried(
    name: str, groups: tuple[str, ...], data: bytes, rules: Rules, judge: Callable[[Avatar], Scorer] | None
) -> Verdicts:
    """Try all rules on one photo.

    Args:
        name: of the photo.
        groups: what it has.
        data: its file.
        rules: on trial.
        judge: makes a scorer for the fit of an avatar; None without truth.

    Raises:
        AvatarError: as ``make_avatar``.
    """
    kept = Kept()
    avatar = rules.make(data, (), kept)
    albedo = _albedo(avatar)
    stages: dict[str, float] = {}

    earliest = FIRST_STAGE["texture"]

    def variant(without: Sequence[str], first: str) -> tuple[Codes, float]:
        own = kept.copy()  # what is made without a rule must not serve the next one
        own.forget(first)
        begin = time.process_time()
        avatar = rules.make(data, without, own)
        taken = time.process_time() - begin
        return _albedo(avatar), taken

    def whole(first: str) -> float:
        if first not in stages:
            stages[first] = float(np.median([variant((), first)[1] for _ in range(REPEATS)]))
        return stages[first]

    scorer = None if judge is None else judge(avatar)
    base = None if scorer is None else scorer.score(_unit(albedo))
    skin, seen = _skin(avatar)
    idle = {who for who, texels in rules.changed(avatar).items() if texels == 0}
    effects: dict[str, Effect] = {}
    every = tuple(rule.name for rule in rules.registry)
    wanted = {rule.name: ((rule.name,), FIRST_STAGE[rule.source]) for rule in rules.registry if rule.source != RELIEF}
    for who, (names, first) in {**wanted, ALL: (every, earliest)}.items():
        if who in idle:
            effects[who] = Effect(0.0, 0.0, float("nan"), float("nan"), None if base is None else base.over(base))
            continue
        with_it = whole(first)
        bare, taken = variant(names, first)
        apart = np.abs(albedo.astype(np.int32) - bare).max(2) > STEP
        gain = None if scorer is None or base is None else base.over(scorer.score(_unit(bare)))
        effects[who] = Effect(_share(apart, skin), _share(apart, seen), with_it - taken, with_it, gain)
    relief = [rule for rule in rules.registry if rule.source == RELIEF]
    effects |= of_relief(data, rules, relief, kept, scorer) if relief else {}
    flat = None if scorer is None else scorer.flat()
    return Verdicts(name, groups, base, flat, effects, avatar.fit.warnings + avatar.texture.warnings)


def of_relief(
    data: bytes, rules: Rules, tried_rules: Sequence[Rule], kept: Kept, scorer: Scorer | None
) -> dict[str, Effect]:
    """Effects of rules for relief by name; ``kept`` has the stages before the albedo."""
    first = FIRST_STAGE[RELIEF]

    def variant(without: Sequence[str]) -> tuple[Avatar, npt.NDArray[np.int16], float]:
        own = kept.copy()
        own.forget(first)
        begin = time.process_time()
        avatar = rules.make(data, without, own, relief=True)
        taken = time.process_time() - begin
        if avatar.reflectance is None or avatar.reflectance.specular_normal is None:
            raise ValueError("the maps of a trial of relief have to have the specular normals")
        return avatar, avatar.reflectance.specular_normal, taken

    variant(())  # loads the network
    runs = [variant(()) for _ in range(REPEATS)]
    avatar, bumps, _ = runs[-1]
    whole = float(np.median([taken for *_, taken in runs]))
    skin, seen = _skin(avatar)
    there, unknown = float("nan") if scorer is None else scorer.relief(avatar), float("nan")
    idle = {who for who, texels in rules.changed(avatar).items() if texels == 0}
    effects = {}
    for rule in tried_rules:
        if rule.name in idle:
            nothing = None if scorer is None else Score(0.0, unknown, unknown, unknown)
            effects[rule.name] = Effect(0.0, 0.0, unknown, unknown, nothing)
            continue
        bare, other, taken = variant((rule.name,))
        apart = np.abs(bumps.astype(np.int32) - other).max(2) > NORMAL_STEP
        gain = None if scorer is None else Score(there - scorer.relief(bare), unknown, unknown, unknown)
        effects[rule.name] = Effect(_share(apart, skin), _share(apart, seen), whole - taken, whole, gain)
    return effects


def _albedo(avatar: Avatar) -> Codes:
    if avatar.reflectance is None or avatar.reflectance.diffuse_albedo is None:
        raise ValueError("the maps of a trial have to have the diffuse albedo")
    return avatar.reflectance.diffuse_albedo


def _unit(codes: Codes) -> npt.NDArray[np.float32]:
    return codes.astype(np.float32) / np.float32(FULL_CODE)


def _share(chosen: npt.NDArray[np.bool_], of: npt.NDArray[np.bool_]) -> float:
    return float((chosen & of).sum() / max(int(of.sum()), 1))


def _skin(avatar: Avatar) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Texels of skin, and those of them that the photo shows, both of the size of the maps."""
    size = avatar.reflectance.size if avatar.reflectance is not None else (0, 0)
    skin = islands(avatar.head, size) == avatar.head.part_names.index("skin")
    seen = cv2.resize(avatar.texture.confidence, size, interpolation=cv2.INTER_NEAREST) >= SEEN
    return skin, skin & seen
