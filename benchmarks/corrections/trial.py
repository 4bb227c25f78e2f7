"""One photo with all rules of the product, without each, and without any: what each changed, gained and took."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.corrections.score import Score
from service.archive.avatar import Avatar
from service.colour import FULL_CODE
from service.geometry.chart import islands
from service.options import Options
from service.pipeline import make_avatar
from service.reflectance.reflectance_maps import NORMAL_ONE
from service.stage_cache import Stages
from service.texture.texture_maps import SEEN

SIZE = (768, 512)
"""Maps of the trial: a rule decides on the light of 192 x 128 cells or on textures of 576 x 384, whatever the map."""
FIRST_STAGE = {"texture": "texture", "light": "diffuse_albedo", "albedo": "diffuse_albedo", "relief": "diffuse_albedo"}
"""By what a rule alters, the first stage of the pipeline that has to be made anew without it."""
RELIEF = "relief"


class Rule(Protocol):
    """One correction; ``service.corrections.Correction``."""

    @property
    def name(self) -> str:
        """As ``--without`` takes it."""

    @property
    def mends(self) -> str:
        """A sentence."""

    @property
    def source(self) -> str:
        """What it alters, out of ``FIRST_STAGE``."""

    @property
    def cases(self) -> Sequence[str]:
        """Groups of ``benchmarks.corrections.photos.GROUPS`` on which it has to gain; none means all photos."""


class Rules(Protocol):
    """All rules, and the product with a switch for each."""

    @property
    def registry(self) -> Sequence[Rule]:
        """In the order in which they run."""

    def make(self, data: bytes, without: Sequence[str], stages: Stages, relief: bool = False) -> Avatar:
        """The avatar of a photo with the rules of these names turned off. Raises as ``make_avatar``.

        It has the diffuse albedo, and with ``relief`` the specular normals.
        """

    def changed(self, avatar: Avatar) -> dict[str, int]:
        """Texels that each rule which ran changed by more than 1/255; rules may be missing."""


@dataclass(frozen=True)
class Product:
    """The rules of the program, turned off as a caller would."""

    @property
    def registry(self) -> Sequence[Rule]:
        """The program's."""
        from service.reflectance.albedo.diffuse_albedo import REGISTRY

        return tuple(REGISTRY)

    def make(self, data: bytes, without: Sequence[str], stages: Stages, relief: bool = False) -> Avatar:
        """By ``make_avatar``."""
        maps = ("diffuse_albedo", "specular_normal") if relief else ("diffuse_albedo",)
        switches: dict[str, Any] = {"without": tuple(without)} if without else {}
        options = Options(maps=maps, quality="draft", size=SIZE, face="largest", **switches)
        return make_avatar(data, options, stages=stages)

    def changed(self, avatar: Avatar) -> dict[str, int]:
        """As the manifest has it."""
        told = getattr(avatar.reflectance, "corrections", ())
        return {one.name: int(one.changed) for one in told}


T = TypeVar("T")


class Kept:
    """Keeps what stages gave, and forgets what comes after a rule; ``service.stage_cache.Stages``."""

    def __init__(self) -> None:
        self._results: dict[str, Any] = {}

    def keep(self, name: str, make: Callable[[], T]) -> T:
        """The result of stage ``name``, made at most once."""
        if name not in self._results:
            self._results[name] = make()
        result: T = self._results[name]
        return result

    def copy(self) -> Kept:
        """Another that has the same results."""
        other = Kept()
        other._results.update(self._results)
        return other

    def forget(self, first: str) -> None:
        """Forget stage ``first`` and all that ran after it; nothing where it has not run."""
        names = list(self._results)
        for name in names[names.index(first) :] if first in names else []:
            del self._results[name]


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
