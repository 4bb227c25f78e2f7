"""Measure every variant of every stage: time, loss against the reference, and the machine's lower bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.bench import material, quantise, stages
from service.bench.loss import Kind, compare
from service.bench.pareto import pareto
from service.bench.result import Row
from service.bench.setting import STAGES_SHARE, Progress, Setting
from service.bench.variants import INT8, NETWORKS, STAGES, TRANSLATORS, Family, StageName, Variant, reference, variants
from service.bench.work import count
from service.errors import AvatarError, ModelFault
from service.levels import FULL_SIZE
from service.runtime.networks import Engine, choose_engine, describe

KINDS: dict[StageName, Kind] = {
    "zeta": "colour", "delta": "colour", "psi": "colour", "rho": "normal", "sigma": "normal", "integration": "height",
    "encoding": "normal",
}  # fmt: skip

BEATEN = 1.1
"""Factor by which another runtime has to be faster for a note that ``--runtime auto`` chose wrong."""


def _with_sources(chosen: Sequence[StageName], at: Setting) -> list[StageName]:
    """Stages to run: those that are chosen and possible, and those that compute their inputs."""
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


def measure_stages(at: Setting, chosen: Sequence[StageName], progress: Progress) -> list[Row]:
    """A row for each variant of the chosen stages, with the fault of those that fail.

    Raises:
        ModelFault: a reference fails.
    """
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


def _quantise(at: Setting, wanted: list[StageName]) -> None:
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


def _measure(at: Setting, variant: Variant) -> Row:
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


def _floor(at: Setting, variant: Variant, engine: Engine) -> float | None:
    """Seconds for a whole chart without padding, if products and copies ran at the machine's rates."""
    texels = variant.width**2 * FULL_SIZE[1] / FULL_SIZE[0]
    if variant.stage == "integration":
        return at.rates.floor(0, 8 * texels, "fp32")  # two int16 in, a float32 out
    if variant.stage == "encoding":
        return at.rates.floor(0, 6 * texels, "fp32")  # three 16-bit codes in; the file is smaller
    if variant.knob:
        return None
    operations = moved = 0.0
    for name in NETWORKS[variant.stage]:
        key = f"{engine.folder}/{name}"
        if key not in at.works:
            if name not in at.family(variant).networks:
                continue
            folder = at.family(variant).folder  # quantisation does not change the number of operations
            at.works[key] = (at.launch(count, name, folder), describe(name, folder))
        work, what = at.works[key]
        height, width = at.material.texture.shape[:2]
        pixels = 1.0 if what.whole else float(width * height) if variant.stage == "zeta" else texels
        operations += 2 * work.multiply_adds * pixels
        moved += 4 * work.numbers * pixels + work.weights
    return at.rates.floor(operations, moved, variant.precision)


def rule_notes(rows: Sequence[Row], threads: int, first: Family) -> list[str]:
    """Notes on stages where ``auto`` chooses a runtime that another one outran by more than a tenth."""
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


def marked(rows: list[Row]) -> list[Row]:
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
