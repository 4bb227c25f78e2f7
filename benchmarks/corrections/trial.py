"""One photo with all rules of the product, without each, and without any: what each changed, gained and took."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, TypeVarTuple

import numpy as np
import numpy.typing as npt

from benchmarks.corrections.score import Judge, Score
from service.archive.avatar import Avatar
from service.colour import FULL_CODE
from service.corrections import Correction
from service.options import Options
from service.pipeline import make_avatar
from service.reflectance.albedo.diffuse_albedo import REGISTRY
from service.stage_cache import StageCache

SIZE = (768, 512)
"""Maps of the trial: a rule decides on the light of 192 x 128 cells or on textures of 576 x 384, whatever the map."""
FIRST_STAGE = "diffuse_albedo"
"""The first stage of the pipeline that has to be made anew without a rule."""


@dataclass(frozen=True)
class Product:
    """The rules of the program, turned off as a caller would."""

    @property
    def registry(self) -> Sequence[Correction]:
        """The program's."""
        return tuple(REGISTRY)

    def make(self, data: bytes, without: Sequence[str], stages: StageCache) -> Avatar:
        """The diffuse albedo of a photo with the rules of these names turned off. Raises as ``make_avatar``."""
        switches: dict[str, Any] = {"without": tuple(without)} if without else {}
        options = Options(maps=("diffuse_albedo",), quality="draft", size=SIZE, face="largest", **switches)
        return make_avatar(data, options, stages=stages)

    def changed(self, avatar: Avatar) -> dict[str, int]:
        """As the manifest has it."""
        told = getattr(avatar.reflectance, "corrections", ())
        return {one.name: int(one.changed) for one in told}


T = TypeVar("T")
Given = TypeVarTuple("Given")


class Kept:
    """Keeps what stages gave, and forgets what comes after a rule; ``service.stage_cache.StageCache``."""

    def __init__(self) -> None:
        self._results: dict[str, Any] = {}

    def get_or_compute(self, name: str, make: Callable[[*Given], T], *given: *Given) -> T:
        """The result of stage ``name``, made at most once."""
        if name not in self._results:
            self._results[name] = make(*given)
        result: T = self._results[name]
        return result

    def before(self, first: str) -> Kept:
        """Another that has the results of the stages that ran before stage ``first``."""
        other, names = Kept(), list(self._results)
        for name in names[: names.index(first)] if first in names else names:
            other._results[name] = self._results[name]
        return other


Codes = npt.NDArray[np.uint16]
Map = npt.NDArray[np.float32]

ALL = "all of these"
"""Name of the variant without any rule."""
REPEATS = 2
"""Times that the whole is made with all rules; its time is their median."""


@dataclass(frozen=True)
class Effect:
    """What one rule does to one photo, as the difference to the photo without it.

    Attributes:
        seconds: that the rule takes of a processor; NaN where it had nothing to do and was not run without.
        whole_seconds: that the stages which were made anew take with it; NaN likewise.
        gain: what the rule makes better.
    """

    seconds: float
    whole_seconds: float
    gain: Score


@dataclass(frozen=True)
class Verdicts:
    """Of one photo.

    Attributes:
        photo, groups: its name and what it has.
        score, flat: with all rules, and of the one colour that is the mean of the true ones.
        effects: by rule, and of all together as ``ALL``.
        warnings: of the avatar.
    """

    photo: str
    groups: tuple[str, ...]
    score: Score
    flat: Score
    effects: dict[str, Effect]
    warnings: tuple[str, ...] = ()


def tried(
    name: str, groups: tuple[str, ...], data: bytes, rules: Product, judge: Callable[[Avatar], Judge]
) -> Verdicts:
    """Try all rules on one photo.

    Args:
        name: of the photo.
        groups: what it has.
        data: its file.
        rules: on trial.
        judge: makes a scorer for the fit of an avatar.

    Raises:
        AvatarError: as ``make_avatar``.
    """
    kept = Kept()
    avatar = rules.make(data, (), kept)
    albedo = _albedo(avatar)

    def variant(without: Sequence[str]) -> tuple[Codes, float]:
        own = kept.before(FIRST_STAGE)  # what is made without a rule must not serve the next one
        begin = time.process_time()
        avatar = rules.make(data, without, own)
        return _albedo(avatar), time.process_time() - begin

    with_all = float(np.median([variant(())[1] for _ in range(REPEATS)]))
    scorer = judge(avatar)
    base = scorer.score(_unit(albedo))
    idle = {who for who, texels in rules.changed(avatar).items() if texels == 0}
    effects: dict[str, Effect] = {}
    every = tuple(rule.name for rule in rules.registry)
    for who, names in {**{name: (name,) for name in every}, ALL: every}.items():
        if who in idle:
            effects[who] = Effect(float("nan"), float("nan"), base.over(base))
            continue
        bare, taken = variant(names)
        effects[who] = Effect(with_all - taken, with_all, base.over(scorer.score(_unit(bare))))
    return Verdicts(name, groups, base, scorer.flat(), effects, avatar.fit.warnings + avatar.texture.warnings)


def _albedo(avatar: Avatar) -> Codes:
    if avatar.reflectance is None or avatar.reflectance.diffuse_albedo is None:
        raise ValueError("the maps of a trial have to have the diffuse albedo")
    return avatar.reflectance.diffuse_albedo


def _unit(codes: Codes) -> npt.NDArray[np.float32]:
    return codes.astype(np.float32) / np.float32(FULL_CODE)
