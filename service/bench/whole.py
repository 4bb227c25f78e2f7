"""Runs from a photo to an archive: all levels, other sizes, and draft quality with other engines."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.bench.losses import FittedLine, Kind, compare, line, pareto
from service.bench.sample_head import SampleHead, resized_mask
from service.bench.variants import (
    STAGES_SHARE,
    BenchExtent,
    Family,
    Made,
    Progress,
    Setting,
    Whole,
    WholeRow,
    precisions,
)
from service.diagnosis import peak_rss_mb
from service.errors import AvatarError
from service.levels import FULL_SIZE, LEVELS, SMALLEST_ENLARGED
from service.reflectance.reflectance_plan import ROLES, ReflectancePlan
from service.runtime.network_registry import networks_of
from service.runtime.networks import Engine, choose_engine
from service.runtime.sessions import model_table

COMPARED: dict[str, Kind] = {
    "diffuse_albedo": "colour", "specular_albedo": "colour", "specular_normal": "normal", "diffuse_normal": "normal",
}  # fmt: skip
"""Maps whose loss is reported."""

WRITING = "write"
"""Name of the time of writing the archive."""


def make_whole(run: Whole, photo: bytes, folder: Path, output: Path) -> Made:
    """Make an avatar, write its archive, and write the window of its maps to ``output`` (``.npz``).

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    begin = time.perf_counter()
    from service.archive.pack import write_archive
    from service.options import TEXTURE_MAPS, Options
    from service.pipeline import make_avatar
    from service.reflectance.reflectance import make_reflectance
    from service.reflectance.subject import Subject

    there = set(model_table(run.engine.folder))
    roles = tuple(role for role in ROLES if set(ReflectancePlan.of([role], super_resolution=False).networks) <= there)
    size = None if run.width is None else (run.width, run.width * 2 // 3)
    options = Options(maps=(*roles, *TEXTURE_MAPS), quality=run.quality, size=size, face="largest")  # type: ignore[arg-type]
    enlarged = options.level.super_resolution and options.map_size[0] >= SMALLEST_ENLARGED
    plan = ReflectancePlan.of(
        roles,
        super_resolution=enlarged and set(networks_of("super_resolution")) <= there,
        keep_cliffs=options.level.keep_cliffs,
    )
    avatar = make_avatar(photo, replace(options, maps=TEXTURE_MAPS, size=options.base_size))
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    reflectance = make_reflectance(
        avatar.texture.texture, subject, plan, options.map_size, run.engine, tile=run.tile
    )  # fmt: skip
    avatar = replace(avatar, reflectance=reflectance, options=options.to_json())
    writing = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "avatar.zip"
        write_archive(avatar, target)
        megabytes = target.stat().st_size / 1e6
    end = time.perf_counter()
    timings = {**avatar.timings_s, **reflectance.timings_s, WRITING: end - writing}
    peak = peak_rss_mb()
    window = SampleHead.load(folder).window
    maps: dict[str, npt.NDArray[Any]] = {
        name: window.of(values) for name in COMPARED if (values := getattr(reflectance, name)) is not None
    }
    np.savez(output, **maps)  # type: ignore[arg-type]
    return Made(end - begin, timings, peak, megabytes, options.map_size[0])


def whole_runs(at: BenchExtent, families: Sequence[Family], threads: int) -> list[Whole]:
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
    others = _draft_runs(at, families, engine) if at.draft else []
    return [*others, *sizes, *levels]


def _draft_runs(at: BenchExtent, families: Sequence[Family], engine: Engine) -> list[Whole]:
    """Draft quality with other engines, tiles and networks."""
    found = []
    networks = ReflectancePlan.of(ROLES, super_resolution=LEVELS["draft"].super_resolution).networks
    for runtime, precision in [("onnxruntime", "fp32"), *precisions()]:
        other = Engine(runtime, precision, engine.threads, engine.folder)
        if any(other.of(name) != engine.of(name) for name in networks):
            found.append(Whole(f"draft, {runtime} {precision}", "draft", other))
    found += [Whole(f"draft, tile {tile}", "draft", engine, tile=tile) for tile in at.tiles[:1]]
    found += [Whole(f"draft, {family.name}", "draft", replace(engine, folder=family.folder)) for family in families[1:]]
    return found


def measure_wholes(at: Setting, progress: Progress) -> list[WholeRow]:
    """A row for each whole run; losses are against the last, the reference."""
    runs = whole_runs(at.extent, at.families, at.threads)
    rows = []
    for index, run in enumerate(runs):
        progress(run.label, STAGES_SHARE + (1 - STAGES_SHARE) * index / len(runs))
        try:
            made: Made = at.launch(make_whole, run, at.photo, at.folder, at.folder / f"whole{index}.npz")
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
                        resized_mask(at.head.skin, best[name].shape[0]),
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


def straight(rows: Sequence[WholeRow], extent: BenchExtent) -> FittedLine | None:
    """Line through seconds without super-resolution, whose cost does not depend on the size of the map."""
    points = dict(sized(rows, extent))
    return line(*zip(*sorted(points.items()), strict=True)) if len(points) > 2 else None


def sized(rows: Sequence[WholeRow], extent: BenchExtent | None = None) -> list[tuple[float, float]]:
    """(megatexels, seconds without super-resolution) of the runs at different sizes."""
    found = []
    for row in rows:
        if row.made is None or not (row.run.width or row.run.label.split(", ")[0] == "standard"):
            continue
        seconds = row.made.seconds - row.made.timings_s.get("super_resolution", 0.0)
        found.append((row.made.width**2 * 2 / 3 / 1e6, seconds))
    return found
