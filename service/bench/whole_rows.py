"""Measure runs from photo to archive: all levels, other sizes, and draft quality with other engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from service.bench import material
from service.bench.loss import compare
from service.bench.pareto import Line, line, pareto
from service.bench.result import WholeRow
from service.bench.setting import STAGES_SHARE, Progress, Setting
from service.bench.variants import INT8, Extent, Family, precisions
from service.bench.whole import COMPARED, Made, Whole, make
from service.errors import AvatarError
from service.levels import FULL_SIZE, LEVELS
from service.reflectance.plan import ROLES, Plan
from service.runtime.networks import Engine, choose_engine
from service.runtime.networks import Precision as EnginePrecision


def whole_runs(at: Extent, families: Sequence[Family], threads: int, int8: Mapping[str, Path]) -> list[Whole]:
    """Whole runs; the last is the reference. Levels with equal settings on this machine share one run."""
    folder = families[0].folder
    runs: dict[tuple[object, ...], Whole] = {}
    for name in at.levels:
        level = LEVELS[name]
        engine = choose_engine(threads=threads, precision=level.precision, folder=folder)
        key = (level.size, level.super_resolution, level.normal_bits, level.fine_mesh, level.keep_cliffs, engine)
        runs[key] = Whole(f"{runs[key].label}, {name}" if key in runs else name, name, engine)
    levels = list(runs.values())
    engine = choose_engine(threads=threads, folder=folder)
    quality = "standard" if "standard" in at.levels else "draft"
    widths = [width for width in at.sizes if not ("standard" in at.levels and width == FULL_SIZE[0])]
    sizes = [Whole(f"{quality}, {width} wide", quality, engine, width) for width in widths]
    others = _draft_runs(at, families, engine, int8) if at.draft else []
    return [*others, *sizes, *levels]


def _draft_runs(at: Extent, families: Sequence[Family], engine: Engine, int8: Mapping[str, Path]) -> list[Whole]:
    """Draft quality with other engines, tiles and networks."""
    found = []
    networks = Plan.of(ROLES, super_resolution=LEVELS["draft"].super_resolution).networks
    for runtime, precision in (("onnxruntime", "fp32"), *precisions(at)):
        if precision in INT8 and precision not in int8:
            continue
        computed: EnginePrecision = "bf16" if precision == "bf16" else "fp32"
        other = Engine(runtime, computed, engine.threads, int8.get(precision, engine.folder))
        if any(other.of(name) != engine.of(name) for name in networks):
            found.append(Whole(f"draft, {runtime} {precision}", "draft", other))
    found += [Whole(f"draft, tile {tile}", "draft", engine, tile=tile) for tile in at.tiles[:1]]
    found += [Whole(f"draft, {family.name}", "draft", replace(engine, folder=family.folder)) for family in families[1:]]
    return found


def measure_wholes(at: Setting, progress: Progress) -> list[WholeRow]:
    """A row for each whole run; losses are against the last, the reference."""
    runs = whole_runs(at.extent, at.families, at.threads, at.int8)
    rows = []
    for index, run in enumerate(runs):
        progress(run.label, STAGES_SHARE + (1 - STAGES_SHARE) * index / len(runs))
        try:
            made: Made = at.launch(make, run, at.photo, at.folder, at.folder / f"whole{index}.npz")
            rows.append(WholeRow(run, made))
        except AvatarError as error:
            rows.append(WholeRow(run, fault=error.message))
    if not rows:
        return rows
    if rows[-1].fault:
        at.notes.append("whole runs have no losses: the reference run failed")
        return rows
    with np.load(at.folder / f"whole{len(rows) - 1}.npz") as file:
        best = {name: file[name] for name in file.files}
    for index, row in enumerate(rows):
        if row.made is not None:
            with np.load(at.folder / f"whole{index}.npz") as file:
                losses = {
                    name: compare(
                        COMPARED[name], file[name], best[name],
                        material.resized_mask(at.material.skin, best[name].shape[0]),
                    )
                    for name in file.files if name in best
                }  # fmt: skip
            rows[index] = replace(row, losses=losses)
    return rows


def marked_wholes(rows: list[WholeRow]) -> list[WholeRow]:
    """Rows with the Pareto front of time and the losses of all maps."""
    points = []
    for row in rows:
        losses = row.losses or {}
        errors = [losses[name].at_full if name in losses else float("nan") for name in _told(rows)]
        points.append((row.made.seconds if row.made else float("nan"), *errors))
    return [replace(row, front=front) for row, front in zip(rows, pareto(points), strict=True)] if rows else []


def _told(rows: Sequence[WholeRow]) -> list[str]:
    return [name for name in COMPARED if any(name in (row.losses or {}) for row in rows)]


def straight(rows: Sequence[WholeRow], extent: Extent) -> Line | None:
    """Line through seconds without super-resolution, whose cost does not depend on the size of the map."""
    points = dict(sized(rows, extent))
    return line(*zip(*sorted(points.items()), strict=True)) if len(points) > 2 else None


def sized(rows: Sequence[WholeRow], extent: Extent | None = None) -> list[tuple[float, float]]:
    """(megatexels, seconds without super-resolution) of the runs at different sizes."""
    found = []
    for row in rows:
        if row.made is None or not (row.run.width or row.run.label.split(", ")[0] == "standard"):
            continue
        seconds = row.made.seconds - row.made.timings_s.get("super_resolution", 0.0)
        found.append((row.made.width**2 * 2 / 3 / 1e6, seconds))
    return found
