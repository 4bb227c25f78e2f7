"""Each rule's gain is that of the photo with it over the photo without it; idle rules are not run without."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.corrections.kept import Kept
from benchmarks.corrections.score import Score
from benchmarks.corrections.table import own_cases, page, rule_rows, verdict
from benchmarks.corrections.trial import ALL, Effect, Verdicts, tried
from service.stage_cache import Stages
from tests.toyhead import sphere_head

SIZE = (96, 64)
SOURCE = {"fit": "", "texture": "texture", "diffuse_albedo": "light"}


@dataclass(frozen=True)
class Rule:
    name: str
    adds: float
    cases: tuple[str, ...] = ()
    source: str = "light"
    mends: str = "A sentence."


@dataclass
class Toy:
    """Rules that add a constant to an albedo of 0.5; the truth has 0.6."""

    registry: Sequence[Rule]
    told: bool = True
    runs: list[tuple[str, ...]] = field(default_factory=list)
    made: list[str] = field(default_factory=list)

    def make(self, data: bytes, without: Sequence[str], stages: Stages, relief: bool = False) -> Any:
        self.runs.append(tuple(without))

        def stage(name: str, before: float) -> float:
            self.made.append(name)
            on = [one.adds for one in self.registry if one.source == SOURCE[name] and one.name not in without]
            return before + sum(on)

        stages.keep("fit", lambda: stage("fit", 0.0))
        texture = stages.keep("texture", lambda: stage("texture", 0.5))
        value = stages.keep("diffuse_albedo", lambda: stage("diffuse_albedo", texture))
        albedo = np.full((*SIZE[::-1], 3), round(65535 * value), np.uint16)
        bumps = np.full((*SIZE[::-1], 2), 30000 * sum(r.adds for r in self.registry if r.name not in without), np.int16)
        confidence = np.full(SIZE[::-1], 255, np.uint8)
        confidence[:, : SIZE[0] // 2] = 0
        return SimpleNamespace(
            head=sphere_head(),
            reflectance=SimpleNamespace(diffuse_albedo=albedo, specular_normal=bumps if relief else None, size=SIZE),
            texture=SimpleNamespace(confidence=confidence, warnings=("little-seen",)),
            fit=SimpleNamespace(warnings=()),
        )

    def changed(self, avatar: Any) -> dict[str, int]:
        return {rule.name: int(rule.adds != 0) for rule in self.registry} if self.told else {}


class Scorer:
    """Decibels are a hundredth of the error, upside down."""

    def score(self, albedo: np.ndarray) -> Score:
        error = abs(float(albedo.mean()) - 0.6)
        return Score(-100 * error, -200 * error, 10 * error, float("nan"))

    def flat(self) -> Score:
        return self.score(np.full((2, 2, 3), 0.55))

    def relief(self, avatar: Any) -> float:
        return float(avatar.reflectance.specular_normal.mean()) / 30000


GOOD, BAD, IDLE = Rule("good", 0.1, ("hard",)), Rule("bad", 0.02, source="texture"), Rule("idle", 0.0)


def verdicts(toy: Toy, groups: tuple[str, ...] = ("hard",)) -> Verdicts:
    return tried("photo", groups, b"", toy, lambda avatar: Scorer())


def test_gains_are_with_the_rule_less_without_it() -> None:
    toy = Toy((GOOD, BAD, IDLE))
    found = verdicts(toy)
    assert found.score is not None and found.score.best == pytest.approx(-2, abs=0.01)
    gains = {name: effect.gain.best for name, effect in found.effects.items() if effect.gain is not None}
    # 0.62 with all; 0.52 without the good one, 0.60 without the bad one, 0.50 without any.
    assert gains == pytest.approx({"good": 6.0, "bad": -2.0, "idle": 0.0, ALL: 8.0}, abs=0.01)
    assert found.effects["bad"].gain is not None and found.effects["bad"].gain.delta_e == pytest.approx(-0.2, abs=0.01)
    assert found.warnings == ("little-seen",)


def test_what_was_made_without_one_rule_does_not_serve_the_next() -> None:
    """A rule of the texture comes first: the texture without it must not be that of the rules that follow."""
    gains = [verdicts(Toy(order)).effects["good"].gain for order in ((GOOD, BAD), (BAD, GOOD))]
    assert gains[0] is not None and gains[1] is not None
    assert gains[0].best == pytest.approx(gains[1].best, abs=1e-9)


def test_a_rule_that_says_it_did_nothing_is_not_run_without() -> None:
    toy = Toy((GOOD, IDLE))
    found = verdicts(toy)
    assert ("idle",) not in toy.runs and found.effects["idle"].changed == 0
    untold = Toy((GOOD, IDLE), told=False)
    again = verdicts(untold)
    assert ("idle",) in untold.runs and again.effects["idle"].changed == 0


def test_a_rule_of_relief_is_judged_by_the_normals_alone() -> None:
    toy = Toy((GOOD, Rule("flatter", 0.2, source="relief"), Rule("still", 0.0, source="relief")))
    found = verdicts(toy)
    flatter, still = found.effects["flatter"], found.effects["still"]
    assert flatter.gain is not None and still.gain is not None
    assert flatter.gain.best == pytest.approx(0.2, abs=1e-3) and np.isnan(flatter.gain.raw)
    assert flatter.changed == 1 and still.changed == 0 and ("still",) not in toy.runs
    assert any("flatter, normals" in row or "any, normals" in row for row in rule_rows(toy.registry, [found], []))


def test_what_no_rule_touches_is_made_once_and_a_rule_of_the_texture_makes_the_texture_anew() -> None:
    toy = Toy((GOOD,))
    verdicts(toy)
    before = toy.made.count("texture")
    toy = Toy((GOOD, BAD))
    verdicts(toy)
    assert toy.made.count("fit") == 1
    assert toy.made.count("texture") == before + 1


def test_texels_are_counted_on_skin_and_on_seen_skin() -> None:
    found = verdicts(Toy((GOOD,)))
    assert found.effects["good"].changed == 1 and found.effects["good"].changed_seen == 1
    tiny = verdicts(Toy((Rule("tiny", 0.9 / 255),)))
    assert tiny.effects["tiny"].changed == 0


def test_kept_results_are_forgotten_from_a_stage_on() -> None:
    kept, made = Kept(), []
    for _ in range(2):
        for name in ("fit", "texture", "albedo"):
            kept.keep(name, lambda name=name: made.append(name))  # type: ignore[misc]
        kept.forget("texture")
        kept.forget("unheard of")
    assert made == ["fit", "texture", "albedo", "texture", "albedo"]


def effect(best: float, raw: float = 0.0, unseen: float = float("nan")) -> Effect:
    return Effect(0.5, 0.25, 0.01, 1.0, Score(best, raw, 0.0, unseen))


def test_a_verdict_wants_a_tenth_of_a_decibel_on_the_rules_own_cases() -> None:
    assert verdict([effect(0.3), effect(-0.05)]) == "yes"
    assert verdict([effect(0.05, raw=0.3)]) == "brightness"
    assert verdict([effect(0.05, unseen=0.2), effect(0.0)]) == "unseen skin"
    assert verdict([effect(0.09)]) == "no"
    assert verdict([]) == "no"
    hard, soft = (Verdicts(name, (name,), None, None, {}) for name in ("hard", "soft"))
    assert own_cases(GOOD, [hard, soft]) == [hard] and own_cases(IDLE, [hard, soft]) == [hard, soft]


def test_the_page_has_the_best_rule_first_and_every_photo() -> None:
    toy = Toy((BAD, GOOD, IDLE))
    found = [verdicts(toy), verdicts(Toy((BAD, GOOD, IDLE)), ("soft",))]
    real = [tried("real", (), b"", Toy((BAD, GOOD, IDLE)), None)]
    rows = rule_rows(toy.registry, found, real)
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| good", "| idle", "| bad", f"| {ALL}"]
    assert "100.0 %, 100.0 %" in rows[2]
    text = page(toy.registry, found, real, SIZE)
    assert text.count("| photo |") == 3 and "2 photos" in text and "1 are real" in text
