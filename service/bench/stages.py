"""Run and time every variant of every stage, and compare its map with the reference's."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.bench.losses import Kind, compare, pareto
from service.bench.sample_head import SampleHead, resized_mask
from service.bench.variants import (
    CLIFFS,
    NETWORKS,
    STAGES,
    STAGES_SHARE,
    TRANSLATORS,
    Family,
    MeasuredStage,
    Progress,
    Row,
    Setting,
    StageName,
    Variant,
    reference,
    variants,
)
from service.colour import to_codes
from service.diagnosis import peak_rss_mb
from service.errors import AvatarError, ModelFault
from service.levels import FULL_SIZE
from service.reflectance.albedo.diffuse_albedo import LIGHT_NETWORK, found_by, needs_context
from service.reflectance.planes import Planes
from service.reflectance.relief.normal_inputs import drawn_detail, shaded_grey
from service.runtime.network_registry import DRAWN_DETAIL, SHADED_GREY
from service.runtime.networks import Description, Engine, Network, choose_engine, open_network
from service.runtime.tiles import Tile, run_tiles, tiles

Result = npt.NDArray[Any]

LONG_S = 4.0
"""Runs that take longer are not repeated, as start-up is a small part of them."""


def measure_stage(variant: Variant, engine: Engine, folder: Path, output: Path, repeats: int) -> MeasuredStage:
    """Run a variant once and ``repeats`` times more, and write the window of its map to ``output``.

    Args:
        variant: what to run.
        engine: of its networks; its folder has the family in the variant's precision.
        folder: of the material.
        output: ``.npy`` file.
        repeats: runs after the first, of which the fastest counts; the first counts with 0, or where it took longer
            than ``LONG_S``.

    Raises:
        AvatarError: as the stage raises it.
    """
    material = SampleHead.load(folder)
    ways: dict[str, Callable[[], _Workload]] = {
        "zeta": lambda: _zeta(variant, engine, material),
        "integration": lambda: _integration(variant, material),
        "encoding": lambda: _encoding(variant, material),
    }
    if variant.stage in TRANSLATORS:
        with open_network(variant.stage, engine) as network:
            job = _translation(variant, engine, network, material)
            result, seconds = _timed(job.work, repeats)
    else:
        job = ways[variant.stage]()
        result, seconds = _timed(job.work, repeats)
    size = None
    if isinstance(result, bytes):
        size, result = len(result) / 1e6 * job.scale, _decoded(variant, result)
    np.save(output, material.window.of(result) if variant.stage == "zeta" else result)
    return MeasuredStage(job.fixed_s + seconds * job.scale, job.fixed_s + seconds, peak_rss_mb(), size)


@dataclass(frozen=True)
class _Workload:
    """A function to time, the factor from window to whole chart, and seconds that do not grow with the chart."""

    work: Callable[[], Any]
    scale: float = 1.0
    fixed_s: float = 0.0


def _timed(work: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    seconds: list[float] = []
    result = None
    while len(seconds) <= repeats and max(seconds, default=0.0) < LONG_S:
        result = None  # frees the memory of the last run first
        begin = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - begin)
    return result, min(seconds[1:] or seconds)


def _zeta(variant: Variant, engine: Engine, material: SampleHead) -> _Workload:
    from service.reflectance.super_resolution import Grain, enlarge, resample

    if variant.knob:
        height, width = material.texture.shape[:2]
        factor = material.result("zeta").shape[0] // material.window.of(material.texture).shape[0]
        size = (width * factor, height * factor)
        return _Workload(lambda: resample(material.texture, size))
    return _Workload(lambda: enlarge(material.whole_texture(), Grain(), engine, variant.tile))


def _translation(variant: Variant, engine: Engine, network: Network, material: SampleHead) -> _Workload:
    what = network.description
    if variant.halo < 1:
        what = replace(what, halo=int(what.halo * variant.halo) // what.stride * what.stride)
        network = replace(network, description=what)
    planes, fixed = inputs(variant, engine, material, what)
    height, width = planes.size[::-1]
    normal = variant.stage in ("rho", "sigma")

    def run() -> Result:
        from service.reflectance.translate import pack_normals

        result: Result = np.zeros((height, width, 2), np.int16) if normal else np.zeros(
            (height, width, len(what.outputs)), np.uint16)  # fmt: skip

        def keep(tile: Tile, values: Float32) -> None:
            packed = pack_normals(*values) if normal else np.moveaxis(to_codes(values), 0, 2)
            result[tile.scaled(1)] = packed

        run_tiles(network, planes.read(what.channels), planes.size, keep, tile=variant.tile)
        return result

    whole = (variant.width, variant.width * FULL_SIZE[1] // FULL_SIZE[0])
    return _Workload(run, computed(whole, variant.tile, what) / computed(planes.size, variant.tile, what), fixed)


def computed(size: tuple[int, int], tile: int, what: Description) -> int:
    """Pixels of input that a network computes for a map (width, height), padding included."""
    return sum(
        (one.bottom - one.top + 2 * what.halo) * (one.right - one.left + 2 * what.halo)
        for one in tiles(*size, tile, what.stride)
    )


def inputs(variant: Variant, engine: Engine, material: SampleHead, what: Description) -> tuple[Planes, float]:
    """Input of a translator in the window, and the seconds of delta's context, which runs once on the whole chart."""
    planes = material.map_planes(variant.width)
    seconds = 0.0
    if variant.stage == "delta" or SHADED_GREY in what.channels:
        planes.add_codes("texture", material.enlarged(variant.width))
        if needs_context(engine):
            with open_network(LIGHT_NETWORK, engine) as network:
                whole = material.whole_texture()
                found, seconds = _timed(lambda: found_by(network, whole), 1)
                names = network.description.planes(len(found.light))
            planes.add_coarse(names, material.window.planes(found.light))
    if variant.stage != "delta":
        seconds, albedo = 0.0, material.albedo(variant.width)
        planes.add_codes("albedo", albedo)
        if SHADED_GREY in what.channels:
            planes.add_grey(SHADED_GREY, shaded_grey(planes, albedo))
            planes.add_coarse([DRAWN_DETAIL], drawn_detail(None, (), 1.0)[None])
            planes.drop("texture")
    return planes, seconds


def _integration(variant: Variant, material: SampleHead) -> _Workload:
    from service.reflectance.relief.displacement import displacement
    from service.reflectance.relief.integration import MOST_STEPS

    side = material.window.pixels(variant.width)
    normals = _shrunk(material.result("rho"), side)
    mask = resized_mask(material.skin, side) > 0
    words, cliffs = variant.knob.removesuffix(CLIFFS), variant.knob.endswith(CLIFFS)
    tolerance = float(words.removeprefix("tolerance "))
    most = 100 if variant == reference("integration") else MOST_STEPS
    steps = material.chart_steps()

    def work() -> Result:
        return displacement(normals, steps, mask, tolerance=tolerance, most_steps=most, keep_cliffs=cliffs)[0]

    return _Workload(work, variant.width**2 * FULL_SIZE[1] / FULL_SIZE[0] / side**2)


def _shrunk(normals: Result, side: int) -> npt.NDArray[np.int16]:
    """Codes of x and y of the mean normals."""
    import cv2

    if normals.shape[0] == side:
        return np.asarray(normals, np.int16)
    small = cv2.resize(normals.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(small), np.int16)


def _encoding(variant: Variant, material: SampleHead) -> _Workload:
    from service.archive.images import Rows, encode_png, encode_png_rows, quantise_normals, to_8_bits
    from service.reflectance.reflectance_maps import unpack_normals

    kind, bits, level = coding(variant.knob)
    stage = "rho" if kind == "normals" else "delta"
    codes = material.result(stage)

    def read(first: int, last: int) -> Any:
        strip = codes[first:last]
        if kind == "normals":
            return quantise_normals(unpack_normals(strip), bits)
        return strip if bits == 16 else to_8_bits(strip)

    def work() -> bytes:
        if level is None:
            return encode_png_rows(Rows((*codes.shape[:2], 3), bits, read), srgb=kind != "normals")
        return encode_png(read(0, len(codes)), srgb=kind != "normals", level=level)

    return _Workload(work, FULL_SIZE[0] * FULL_SIZE[1] / (codes.shape[0] * codes.shape[1]))


def coding(knob: str) -> tuple[str, int, int | None]:
    """Kind of map, bits and OpenCV's compression level of a knob such as "normals 8 bits, level 1"; None: in strips."""
    kind, bits, _, how, level = knob.replace(",", "").split()
    return kind, int(bits), int(level) if how == "level" else None


def _decoded(variant: Variant, data: bytes) -> Result:
    """The decoded PNG in the reference's codes."""
    import cv2

    from service.archive.images import normal_coding
    from service.reflectance.translate import pack_normals

    kind, bits, _ = coding(variant.knob)
    image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))[..., ::-1]
    if kind == "normals":
        zero, scale = normal_coding(bits)
        values = (image.astype(np.float32) - zero) / np.float32(scale)
        return pack_normals(*np.moveaxis(values, 2, 0))
    return image.copy() if bits == 16 else image.astype(np.uint16) * np.uint16(257)


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
    for index, variant in enumerate(todo):
        progress(f"{variant.stage}, {variant.label}", 0.05 + (STAGES_SHARE - 0.05) * index / len(todo))
        if variant not in by_variant:
            by_variant[variant] = _measure(at, variant)
    return [by_variant[variant] for variant in todo]


def _measure(at: Setting, variant: Variant) -> Row:
    output = at.folder / (f"{variant.stage}.npy" if variant.reference else "variant.npy")
    try:
        taken = at.launch(measure_stage, variant, at.engine(variant), at.folder, output, at.extent.repeats)
    except AvatarError as error:
        return Row(variant, fault=error.message)
    source = variant.stage
    kind = KINDS[variant.stage]
    if variant.stage == "encoding":
        what, _, _ = coding(variant.knob)
        source, kind = ("rho", "normal") if what == "normals" else ("delta", "colour")
    best = at.head.result(source)
    loss = compare(kind, np.load(output), best, resized_mask(at.head.skin, best.shape[0]))
    return Row(variant, taken, loss)


def rule_notes(rows: Sequence[Row], threads: int, first: Family) -> list[str]:
    """Notes on stages where ``auto`` chooses a runtime that another one outran by more than a tenth."""
    found = []
    for stage in (*TRANSLATORS, "zeta"):
        taken = {
            f"{row.variant.runtime} {row.variant.precision}": row.measured.seconds
            for row in rows
            if row.measured is not None and row.variant == replace(
                reference(row.variant.stage), runtime=row.variant.runtime, precision=row.variant.precision
            ) and row.variant.stage == stage
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
