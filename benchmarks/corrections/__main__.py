"""What each correction is worth: ``python -m benchmarks.corrections --data DIR [-o docs/corrections.md]``.

Takes each rule that alters what the networks gave out of ``make_avatar``, and all together, and tells what is lost on
rendered photos of known albedo. DIR holds ``ict_facekit_head.npz``,
``ffhq_uv_head/``, ``hifi3d_uv/`` and ``lee_perry_smith/``; what is rendered of them is kept in ``--cache``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.corrections.photos import names, photos
from benchmarks.corrections.score import Judge, Score
from benchmarks.corrections.trial import ALL, SIZE, Effect, Product, Verdicts, tried
from benchmarks.shoot import data_folder
from service.corrections import Correction

ENOUGH_DB = 0.1
"""Gain from which on a rule earns its place."""

HEADER = """# Corrections on trial

The networks' albedo is altered by a list of rules
(`service/reflectance/albedo/diffuse_albedo.py`), each of which can be turned off by
`avatarme make --without NAME`. This page says what is lost when one is taken out. It is made by

    python -m benchmarks.corrections --data DIR -o docs/corrections.md

which makes each avatar by `service.pipeline.make_avatar` with maps of {size[0]} x {size[1]}, once with all rules and
once without each. {count} photos are rendered by Mitsuba of real heads and skins, with known albedo.

- **gain**: of the PSNR of the sRGB-coded albedo of the skin that the photo shows, after the one gain of linear values
  that fits best; with the rule, less without it. *Raw* is without that gain. *Delta E* is CIEDE2000, and counts what it
  falls. *Unseen* is the gain in PSNR on the face's skin that the photo does not show.
- **own cases**: mean over the photos of the groups that the rule names; over all photos where it names none.
- A rule that says itself that it changed no texel of a photo by more than 1/255 is not run without there, and counts
  as 0.
- **time**: of a processor; median over the photos on which the rule had anything to do of the difference between the
  time of the stages with it and without it, and its share of these. Differences of a few ms are noise.
- **earns its place**: at least {enough} dB on its own cases: after the best gain ("yes"), or else raw ("brightness"),
  or else on unseen skin ("unseen skin").
"""


def mean_of(effects: Sequence[Effect], name: str) -> float:
    """Mean of one number of the gains of these effects; NaN where there is none."""
    return known_mean([getattr(one.gain, name) for one in effects])


def known_mean(values: Sequence[float]) -> float:
    """Mean of those that are finite; NaN where none is."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def own_cases(rule: Correction, photos: Sequence[Verdicts]) -> list[Verdicts]:
    """Photos of the groups that a rule names; all where it names none."""
    return [one for one in photos if not rule.cases or set(rule.cases) & set(one.groups)]


def verdict(effects: Sequence[Effect]) -> str:
    """Whether a rule with these effects on its own cases earns its place, and by what."""
    for name, word in (("best", "yes"), ("raw", "brightness"), ("unseen", "unseen skin")):
        if mean_of(effects, name) >= ENOUGH_DB:
            return word
    return "no"


def rule_rows(registry: Sequence[Correction], photos: Sequence[Verdicts]) -> list[str]:
    """Markdown rows, most useful first, all together last."""
    lines = [
        "| rule | own cases | gain there, dB | raw | Delta E | unseen | all photos: mean (least to most) "
        "| time, ms (share) | earns its place |",
        "|---" * 9 + "|",
    ]
    rows = []
    for rule in registry:
        cases = own_cases(rule, photos)
        effects = [one.effects[rule.name] for one in cases]
        label = (", ".join(rule.cases) if rule.cases else "any")
        rows.append((mean_of(effects, "best"), _row(rule.name, label, len(cases), effects, photos)))
    rows.sort(key=lambda one: -np.nan_to_num(one[0]))
    together = [one.effects[ALL] for one in photos]
    return [*lines, *(row for _, row in rows), _row(ALL, "any", len(photos), together, photos, judge=False)]


def _row(
    name: str,
    label: str,
    count: int,
    effects: Sequence[Effect],
    photos: Sequence[Verdicts],
    judge: bool = True,
) -> str:
    gains = [one.effects[name].gain for one in photos]
    best = [one.best for one in gains]
    spread = f"{np.mean(best):+.2f} ({min(best):+.2f} to {max(best):+.2f})" if best else "-"
    ran = [one.effects[name] for one in photos if np.isfinite(one.effects[name].seconds)]
    time = "-"
    if ran:
        milliseconds = 1000 * float(np.median([one.seconds for one in ran]))
        share = 100 * float(np.median([one.seconds / max(one.whole_seconds, 1e-9) for one in ran]))
        time = f"{milliseconds:.0f} ({share:.0f} %)"
    cells = [_signed(mean_of(effects, which)) for which in ("best", "raw", "delta_e", "unseen")]
    word = verdict(effects) if judge else ""
    return " | ".join([f"| {name}", f"{label} ({count})", *cells, spread, time, f"{word} |"])


def photo_rows(photos: Sequence[Verdicts]) -> list[str]:
    """Markdown rows of the rendered photos: how good the albedo is with all rules, and one flat colour."""
    lines = [
        "| photo | has | dB | raw dB | Delta E | unseen dB | flat: dB | raw dB | Delta E | unseen dB | no rules: dB "
        "| warnings |",
        "|---" * 12 + "|",
    ]
    scores: list[list[float]] = []
    for one in photos:
        bare = one.score.best - one.effects[ALL].gain.best
        scores.append([*_numbers(one.score), *_numbers(one.flat), bare])
        told = " | ".join(map(_plain, scores[-1]))
        lines.append(f"| {one.photo} | {', '.join(one.groups)} | {told} | {', '.join(one.warnings)} |")
    if scores:
        told = " | ".join(f"**{_plain(known_mean(column))}**" for column in zip(*scores, strict=True))
        lines.append(f"| mean | | {told} | |")
    return lines


def page(registry: Sequence[Correction], photos: Sequence[Verdicts], size: tuple[int, int]) -> str:
    """The whole page in Markdown."""
    head = HEADER.format(size=size, count=len(photos), enough=ENOUGH_DB)
    mended = [f"- `{rule.name}`: {rule.mends}" for rule in registry]
    parts = [head, *rule_rows(registry, photos), "", "## What each mends", "", *mended]
    return "\n".join([*parts, "", "## The photos", "", *photo_rows(photos), ""])


def _numbers(score: Score) -> tuple[float, float, float, float]:
    return score.best, score.raw, score.delta_e, score.unseen


def _signed(value: float) -> str:
    return f"{value:+.2f}" if np.isfinite(value) else "-"


def _plain(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"


CACHE = Path.home() / ".cache" / "avatarme-bench"


def on_rendered(data: Path, cache: Path, wanted: tuple[str, ...], rules: Product) -> list[Verdicts]:
    """Verdicts on rendered photos, in order."""
    found = []
    for photo in photos(data, cache, wanted):
        begin = time.perf_counter()
        one = tried(photo.name, photo.groups, photo.data, rules, partial(Judge.of, photo))
        typer.echo(f"{photo.name}: {one.score.best:.1f} dB, {time.perf_counter() - begin:.0f} s", err=True)
        found.append(one)
    return found


def trial(data: Path, cache: Path, rules: Product, wanted: tuple[str, ...], jobs: int = 1) -> list[Verdicts]:
    """Verdicts on the photos of the wanted names."""
    cache.mkdir(parents=True, exist_ok=True)
    if jobs == 1:
        return on_rendered(data, cache, wanted, rules)
    for _ in photos(data, cache, wanted):
        pass  # rendered before processes ask for the same sitting
    with ProcessPoolExecutor(jobs) as pool:
        rendered = [pool.submit(on_rendered, data, cache, (name,), rules) for name in wanted]
        return [verdict for one in rendered for verdict in one.result()]


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Markdown page to write.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; times are fit to be told with 1 only.")] = 1,
    quick: Annotated[bool, typer.Option(help="A few photos.")] = False,
) -> None:
    """Print the page, and write it."""
    begin = time.perf_counter()
    folder, rules = data_folder(None if data is None else str(data)), Product()
    text = page(rules.registry, trial(folder, cache, rules, names(quick), jobs), SIZE)
    typer.echo(text)
    typer.echo(f"{time.perf_counter() - begin:.0f} s in all", err=True)
    if output is not None:
        output.write_text(text, "utf-8")


if __name__ == "__main__":
    typer.run(main)
