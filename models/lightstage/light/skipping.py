"""What skipping effects costs and saves: ``python -m models.lightstage.light.skipping [--scenes N] [--write FILE]``.

Bakes random scenes on synthetic subjects with everything on and as planned, compares the mean absolute error over the
face with the bound that the plan states, and times every effect by leaving it out alone. ``--write`` puts the tables
into a Markdown file between the lines ``<!-- skipping -->`` and ``<!-- /skipping -->``.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import multiprocessing
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from models.lightstage.light.bake import bake
from models.lightstage.light.expose import expose
from models.lightstage.light.geometry import Geometry
from models.lightstage.light.prior import sample_scene
from models.lightstage.light.sampling import enlarged
from models.lightstage.light.survey import survey
from models.lightstage.skin.synthesis import SkinMaps
from models.lightstage.skin.window import ChartWindow
from models.lightstage.stage import Stage
from models.tables import tell
from service.light.plan import EFFECTS, LightPlan, plan
from service.light.scene import Scene

TIMED = 8
MARK = ("<!-- skipping -->", "<!-- /skipping -->")


@dataclasses.dataclass(frozen=True)
class Trial:
    """One scene: what was measured (1/255 of sRGB; seconds)."""

    scene: int
    error: float
    bound: float
    full_s: float
    planned_s: float
    plan_s: float
    left_out: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Subject:
    """A head ready to be lit."""

    maps: SkinMaps
    geometry: Geometry
    window: ChartWindow
    face: Tensor


def subjects(seeds: range, width: int, height: int) -> list[Subject]:
    """Synthetic subjects whose whole chart is drawn at one size."""
    stage, window, out = Stage.open(), ChartWindow.whole(width, height), []
    for seed in seeds:
        skin = stage.skin(seed)
        small = (min(width, 192), min(height, 128))
        geometry = Geometry.of(
            stage.head, stage.vertices(skin), size=(width, height), sky_size=small, casters_mm=(3.0, 3.0)
        )
        maps = skin.maps(window)
        face = (enlarged(geometry.face, window)[0] > 0.5) & (maps.mask[0] > 0.5)
        out.append(Subject(maps, geometry, window, face))
    return out


def _timed_bake(subject: Subject, scene: Scene, chosen: LightPlan, *, anew: bool = True) -> tuple[Tensor, float]:
    if anew:
        subject.geometry.forget_shadows()
    start = time.perf_counter()
    image = bake(subject.maps, subject.geometry, scene, chosen, subject.window)
    return image, time.perf_counter() - start


def error(a: Tensor, b: Tensor, face: Tensor) -> float:
    """Mean absolute difference over the face, in 1/255."""
    return float((a - b).abs().mean(0)[face].mean()) * 255.0


def trials(people: list[Subject], scenes: range, tolerance: float) -> Iterator[Trial]:
    """One trial a scene, subjects in turn."""
    for number in scenes:
        subject = people[number % len(people)]
        scene = expose(subject.maps, subject.geometry, sample_scene(number), subject.window)
        start = time.perf_counter()
        chosen = plan(scene, survey(subject.maps, subject.geometry, subject.window), tolerance)
        plan_s = time.perf_counter() - start
        anew = number % TIMED == 0  # shadows are computed anew only where time is taken
        whole, full_s = _timed_bake(subject, scene, LightPlan.everything(scene), anew=anew)
        planned, planned_s = _timed_bake(subject, scene, chosen, anew=anew)
        if not anew:
            full_s = planned_s = 0.0
        names = tuple(d.effect for d in chosen.decisions if not d.runs)
        yield Trial(number, error(whole, planned, subject.face), chosen.bound, full_s, planned_s, plan_s, names)


def _share(width: int, height: int, count: int, scenes: range, tolerance: float) -> list[Trial]:
    """What one process does."""
    with contextlib.suppress(RuntimeError):
        torch.set_num_threads(1)
    done = []
    for trial in trials(subjects(range(100, 100 + count), width, height), scenes, tolerance):
        done.append(trial)
        wrong = " !" if trial.error > trial.bound + 1e-3 else ""
        line = f"scene {trial.scene}: error {trial.error:.3f}, bound {trial.bound:.3f}{wrong}"
        sys.stderr.write(f"{line}\n")
    return done


def by_effect(people: list[Subject], scenes: range) -> dict[str, list[tuple[float, float, float, bool]]]:
    """For every effect: (error, bound, seconds saved, within) of leaving it out alone, for all lights at once."""
    out: dict[str, list[tuple[float, float, float, bool]]] = defaultdict(list)
    for number in scenes:
        subject = people[number % len(people)]
        scene = expose(subject.maps, subject.geometry, sample_scene(number), subject.window)
        full = LightPlan.everything(scene)
        asked = plan(scene, survey(subject.maps, subject.geometry, subject.window), 0.0)
        whole, full_s = _timed_bake(subject, scene, full)
        for effect in EFFECTS:
            items = [d for d in asked.decisions if d.effect == effect]
            chosen = full
            for d in items:
                chosen = chosen.without(d.effect, d.light)
            if not items:
                continue
            image, seconds = _timed_bake(subject, scene, chosen)
            bound, measured = sum(d.bound for d in items), error(whole, image, subject.face)
            out[effect].append((measured, bound, full_s - seconds, measured <= bound + 1e-3))
    return out


def tables(done: list[Trial], single: dict[str, list[tuple[float, float, float, bool]]], size: str) -> str:
    """Both tables in Markdown."""
    errors, bounds = np.array([t.error for t in done]), np.array([t.bound for t in done])
    full, planned = sum(t.full_s for t in done), sum(t.planned_s for t in done)
    within = int((errors <= bounds + 1e-3).sum())
    lines = [
        f"{len(done)} random scenes at {size}, planned against everything on",
        "(`python -m models.lightstage.light.skipping`):",
        f"error within the stated bound {within} of {len(done)} times; mean error {errors.mean():.2f}/255, worst",
        f"{errors.max():.2f}/255; mean bound {bounds.mean():.2f}/255; time {planned / full:.0%} of everything on,",
        f"planning {1000 * float(np.mean([t.plan_s for t in done])):.0f} ms a scene.",
        "",
        "| effect | left out in | error alone, mean / worst | stated bound, mean | within | time saved, ms |",
        "|---|---|---|---|---|---|",
    ]
    for effect, rows in single.items():
        share = np.mean([effect in t.left_out for t in done])
        measured, bound, saved = (np.array([r[i] for r in rows]) for i in range(3))
        lines.append(
            f"| {effect} | {share:.0%} | {measured.mean():.2f} / {measured.max():.2f} | {bound.mean():.2f} "
            f"| {sum(r[3] for r in rows)} of {len(rows)} | {1000 * np.median(saved):.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Command line; fails when a stated bound does not hold."""
    parser = argparse.ArgumentParser(prog="python -m models.lightstage.light.skipping", description=__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--single", type=int, default=24, help="scenes in which effects are left out one by one")
    parser.add_argument("--subjects", type=int, default=4)
    parser.add_argument("--size", default="192x128", help="chart, WxH")
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--write", type=Path)
    chosen = parser.parse_args()
    width, height = (int(part) for part in chosen.size.split("x"))
    jobs = chosen.jobs
    shares = [range(k * chosen.scenes // jobs, (k + 1) * chosen.scenes // jobs) for k in range(jobs)]
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        sizes = (width, height, chosen.subjects)
        work = [pool.submit(_share, *sizes, share, chosen.tolerance) for share in shares if len(share)]
        done = [trial for each in work for trial in each.result()]
    single = by_effect(subjects(range(100, 100 + chosen.subjects), width, height), range(chosen.single))
    tell(tables(done, single, chosen.size), MARK, chosen.write)
    if any(t.error > t.bound + 1e-3 for t in done):
        raise SystemExit("a stated bound does not hold")


if __name__ == "__main__":
    main()
