"""The benchmark: every variant of every stage and of the whole, one after the other, in one run.

Absolute times move from machine to machine; that everything is measured in the same run is what makes ratios hold.
"""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from service import diagnosis
from service.bench import material, quantise, rates, stages
from service.bench.launch import isolated
from service.bench.loss import Kind, compare
from service.bench.pareto import line, pareto
from service.bench.result import Bench, Row, WholeRow
from service.bench.variants import (
    INT8,
    NETWORKS,
    STAGES,
    TRANSLATORS,
    Extent,
    Family,
    StageName,
    Variant,
    precisions,
    reference,
    variants,
)
from service.bench.whole import COMPARED, Made, Whole, make
from service.bench.work import Work, count
from service.errors import AvatarError, ModelFault
from service.levels import FULL_SIZE, LEVELS
from service.reflectance.plan import ROLES, Plan
from service.runtime.describe import Description
from service.runtime.networks import Engine, choose_engine, describe
from service.runtime.networks import Precision as EnginePrecision

Progress = Callable[[str, float], None]
Launch = Callable[..., Any]

KINDS: dict[StageName, Kind] = {
    "zeta": "colour", "delta": "colour", "psi": "colour", "rho": "normal", "sigma": "normal", "integration": "height",
    "encoding": "normal",
}  # fmt: skip

STAGES_SHARE = 0.5
"""Of the progress bar."""

BEATEN = 1.1
"""The rule of ``--runtime auto`` is called wrong where another runtime is so many times as fast."""


@dataclass
class _Setting:
    """What all measurements of a run share."""

    extent: Extent
    families: Sequence[Family]
    folder: Path
    launch: Launch
    photo: bytes
    threads: int
    rates: rates.Rates
    material: material.Material
    notes: list[str] = field(default_factory=list)
    int8: dict[str, Path] = field(default_factory=dict)
    works: dict[str, tuple[Work, Description]] = field(default_factory=dict)

    @property
    def first(self) -> Family:
        """The family that is the reference."""
        return self.families[0]

    def family(self, variant: Variant) -> Family:
        """The networks that a variant is of."""
        return next((family for family in self.families if family.name == variant.family), self.first)

    def engine(self, variant: Variant) -> Engine | None:
        """What a variant's networks run on; None where there are none in eight bits."""
        folder = self.family(variant).folder
        if variant.precision in INT8:
            if variant.precision not in self.int8:
                return None
            folder = self.int8[variant.precision]
        return Engine(
            variant.runtime, "bf16" if variant.precision == "bf16" else "fp32", self.threads, folder
        )  # fmt: skip


def bench(
    extent: Extent,
    families: Sequence[Family],
    *,
    photo: bytes | None = None,
    chosen: Sequence[StageName] = STAGES,
    launch: Launch = isolated,
    progress: Progress = lambda what, done: None,
) -> Bench:
    """Measure.

    Args:
        extent: how much.
        families: of networks; the first is the reference.
        photo: bytes of the photo that it is measured on; None for the sample photo.
        chosen: stages to measure; what they take from others is made by the reference all the same.
        launch: runs a function in a process of its own.
        progress: told what is being measured, and the share that is done.

    Raises:
        ModelFault: the first family has none of the networks, or its networks fail.
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    begin = time.perf_counter()
    first = families[0]
    if not set(first.networks) & {name for names in NETWORKS.values() for name in names}:
        raise ModelFault(f"{first.folder} lists no network of maps; name a folder that does with --networks")
    data = diagnosis.SAMPLE.read_bytes() if photo is None else photo
    threads = choose_engine().threads
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        progress("photo", 0.0)
        size = describe("zeta_body", first.folder).whole if "zeta_body" in first.networks else None
        launch(material.from_photo, data, size, extent.side, folder)
        progress("machine", 0.02)
        found = launch(rates.measure, threads, blas_threads=threads)
        at = _Setting(extent, families, folder, launch, data, threads, found, material.Material.load(folder))
        rows = _measure_stages(at, chosen, progress)
        at.notes.extend(_rule_notes(rows, threads, first))
        wholes = _measure_wholes(at, progress)
    return Bench(
        machine=_machine(threads, families),
        rates=found,
        rows=_marked(rows),
        wholes=_marked_wholes(wholes),
        line=_straight(wholes, extent),
        notes=at.notes,
        seconds=time.perf_counter() - begin,
    )


def _with_sources(chosen: Sequence[StageName], at: _Setting) -> list[StageName]:
    """Stages to run: those that are chosen and possible, and those whose maps they take."""
    sources: dict[StageName, tuple[StageName, ...]] = {
        "delta": ("zeta",), "psi": ("delta",), "rho": ("delta",), "sigma": ("delta",), "integration": ("rho",),
        "encoding": ("delta", "rho"),
    }  # fmt: skip
    wanted = set(chosen)
    for stage in reversed(STAGES):
        wanted |= set(sources.get(stage, ())) if stage in wanted else set()
    possible: list[StageName] = []
    for stage in STAGES:
        missing = [name for name in NETWORKS[stage] if name not in at.first.networks and name != "delta_context"]
        short = [source for source in sources.get(stage, ()) if source not in possible]
        if stage in ("integration", "encoding") and short:
            missing += short
        if stage in wanted and missing:
            at.notes.append(f"{stage} was left out: {at.first.folder} has no {', '.join(missing)}")
        elif stage in wanted:
            possible.append(stage)
    return possible


def _measure_stages(at: _Setting, chosen: Sequence[StageName], progress: Progress) -> list[Row]:
    wanted = _with_sources(chosen, at)
    names = [family.name for family in at.families[1:]]
    todo = list(variants(at.extent, [stage for stage in wanted if stage in chosen], names))
    rows = [_measure(at, reference(stage)) for stage in wanted]
    failed = [row for row in rows if row.fault]
    if failed:
        raise ModelFault(f"the reference of {failed[0].variant.stage} failed: {failed[0].fault}")
    by_variant = {row.variant: row for row in rows}
    if at.extent.int8:
        _quantise(at, [stage for stage in wanted if stage in chosen and NETWORKS[stage]])
    for index, variant in enumerate(todo):
        progress(f"{variant.stage}, {variant.label}", 0.05 + (STAGES_SHARE - 0.05) * index / len(todo))
        if variant not in by_variant:
            by_variant[variant] = _measure(at, variant)
    return [by_variant[variant] for variant in todo]


def _quantise(at: _Setting, wanted: list[StageName]) -> None:
    if not quantise.available():
        at.notes.append("int8 was left out: it needs the package onnx (pip install onnx)")
        return
    for precision in at.extent.int8:
        target = at.folder / precision.replace(" ", "-")
        target.mkdir()
        engine = Engine(threads=at.threads, folder=at.first.folder)
        try:
            at.launch(quantise.quantise, wanted, precision == "int8 static", engine, at.folder, target)
            at.int8[precision] = target
        except AvatarError as error:
            at.notes.append(f"{precision} was left out: {error.message}")


def _measure(at: _Setting, variant: Variant) -> Row:
    engine = at.engine(variant)
    if engine is None:
        return Row(variant, fault="not quantised, see the notes")
    output = at.folder / (f"{variant.stage}.npy" if variant.reference else "variant.npy")
    try:
        taken = at.launch(stages.measure, variant, engine, at.folder, output, at.extent.repeats)
    except AvatarError as error:
        return Row(variant, fault=error.message)
    source = variant.stage
    kind = KINDS[variant.stage]
    if variant.stage == "encoding":
        what, _, _ = stages.coding(variant.knob)
        source, kind = ("rho", "normal") if what == "normals" else ("delta", "colour")
    best = at.material.result(source)
    loss = compare(kind, np.load(output), best, material.resized_mask(at.material.skin, best.shape[0]))
    return Row(variant, taken, loss, _floor(at, variant, engine))


def _floor(at: _Setting, variant: Variant, engine: Engine) -> float | None:
    """Seconds for a whole chart without halos, if products and copies ran at the machine's rates."""
    texels = variant.width**2 * FULL_SIZE[1] / FULL_SIZE[0]
    if variant.stage == "integration":
        return at.rates.floor(0, 8 * texels, "fp32")  # two int16 in, a float32 out
    if variant.stage == "encoding":
        return at.rates.floor(0, 6 * texels, "fp32")  # three 16-bit codes in; what comes out is smaller
    if variant.knob:
        return None
    operations = moved = 0.0
    for name in NETWORKS[variant.stage]:
        key = f"{engine.folder}/{name}"
        if key not in at.works:
            if name not in at.family(variant).networks:
                continue
            folder = at.family(variant).folder  # eight bits do not change the work
            at.works[key] = (at.launch(count, name, folder), describe(name, folder))
        work, what = at.works[key]
        height, width = at.material.texture.shape[:2]
        pixels = 1.0 if what.whole else float(width * height) if variant.stage == "zeta" else texels
        operations += 2 * work.multiply_adds * pixels
        moved += 4 * work.numbers * pixels + work.weights
    return at.rates.floor(operations, moved, variant.precision)


def _rule_notes(rows: Sequence[Row], threads: int, first: Family) -> list[str]:
    """Stages where ``auto`` takes a runtime that another one beat by more than a tenth in this run."""
    found = []
    for stage in (*TRANSLATORS, "zeta"):
        taken = {
            f"{row.variant.runtime} {row.variant.precision}": row.measured.seconds
            for row in rows
            if row.measured is not None and row.variant == replace(
                reference(row.variant.stage), runtime=row.variant.runtime, precision=row.variant.precision
            ) and row.variant.stage == stage and row.variant.precision not in INT8
        }  # fmt: skip
        auto = choose_engine(threads=threads, folder=first.folder).told([NETWORKS[stage][-1]])
        chosen = next(iter(auto.values()))
        if chosen in taken and taken[chosen] > BEATEN * min(taken.values()):
            best = min(taken, key=taken.__getitem__)
            times = taken[chosen] / taken[best]
            found.append(f"{stage}: --runtime auto takes {chosen}; {best} was {times:.2f} times as fast in this run")
    return found


def _marked(rows: list[Row]) -> list[Row]:
    """Rows with the Pareto front of their stage (of their kind of map, for the encoding)."""
    groups: dict[tuple[str, str], list[int]] = {}
    for index, row in enumerate(rows):
        if row.measured is not None and row.loss is not None:
            groups.setdefault((row.variant.stage, row.loss.kind), []).append(index)
    marked = list(rows)
    for members in groups.values():
        points = []
        for index in members:
            measured, loss = rows[index].measured, rows[index].loss
            assert measured is not None and loss is not None  # noqa: S101 - only such were gathered
            points.append((measured.seconds, loss.at_full, measured.megabytes or 0.0))
        for index, front in zip(members, pareto(points), strict=True):
            marked[index] = replace(rows[index], front=front)
    return marked


def whole_runs(at: Extent, families: Sequence[Family], threads: int, int8: Mapping[str, Path]) -> list[Whole]:
    """Runs of the whole; the last is the reference. Levels that come to the same on this machine are one run."""
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
    """Draft by other means than the level's own."""
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


def _measure_wholes(at: _Setting, progress: Progress) -> list[WholeRow]:
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
        at.notes.append("the whole has no losses: the run that is the reference failed")
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


def _marked_wholes(rows: list[WholeRow]) -> list[WholeRow]:
    points = []
    for row in rows:
        losses = row.losses or {}
        errors = [losses[name].at_full if name in losses else float("nan") for name in _told(rows)]
        points.append((row.made.seconds if row.made else float("nan"), *errors))
    return [replace(row, front=front) for row, front in zip(rows, pareto(points), strict=True)] if rows else []


def _told(rows: Sequence[WholeRow]) -> list[str]:
    return [name for name in COMPARED if any(name in (row.losses or {}) for row in rows)]


def _straight(rows: Sequence[WholeRow], extent: Extent) -> Any:
    """The line through seconds, super-resolution left out as its cost does not depend on the size of the map."""
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


def _machine(threads: int, families: Sequence[Family]) -> dict[str, Any]:
    return {
        "processor": diagnosis.cpu(),
        "memory_mb": diagnosis.memory_mb()["total"],
        "platform": platform.platform(),
        "python": platform.python_version(),
        "runtimes": diagnosis.runtimes(),
        "threads": threads,
        "families": {family.name: list(family.networks) for family in families},
    }
