"""What accuracy costs in time, against the truth: ``python -m benchmarks.accuracy_time --data DIR [--write FILE]``.

The runs of ``avatarme bench`` on a rendered photo whose head and albedo are known, one of ``benchmarks.corrections``
(DIR is its folder). To the table of that command this adds how far albedo and normals are from the truth, by which the
Pareto front is told, and seconds against the number of photos of one person.

``--networks`` prints instead what each network of the maps takes of a tile, as installed, on onnxruntime and in PyTorch
eager, with its floor (its work at the rate of a matrix product, or its planes at the rate of a copy), and how much of a
``standard`` of the sample photo passes while no network runs.
"""

from __future__ import annotations

import functools
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.tables import tell
from service import diagnosis
from service.archive.avatar import Avatar
from service.archive.pack import write_archive
from service.arrays import Float32
from service.bench.report import as_markdown
from service.bench.runs import Bench, Row, isolated, line, make, run_bench, runs
from service.levels import FULL_SIZE
from service.options import Options
from service.pipeline import make_avatar
from service.runtime import networks
from service.runtime.networks import Engine, choose_engine, open_network
from service.runtime.tiles import DEFAULT_TILE, tiles

MARK = ("<!-- bench -->", "<!-- /bench -->")
PHOTO = "ffhq_soft"
SAME_PERSON = (PHOTO, "ffhq_left", "ffhq_soft film", "ffhq_left red blown")
"""Photos of one sitter, of which the first so many are given."""
COUNTS = (1, 2, 3, 4)


def judged(name: str, data: Path, cache: Path, avatar: Avatar) -> Mapping[str, float]:
    """Decibels of what a photo of the trial tells: seen skin as it is and after the best gain, unseen skin, normals."""
    # Only now, as what training needs would count as memory of the run.
    from benchmarks.albedo import albedo_of
    from benchmarks.corrections.photos import photos
    from benchmarks.corrections.score import Judge

    photo = next(photos(data, cache, [name]))
    judge = Judge.of(photo, avatar)
    score = judge.score(albedo_of(avatar.reflectance))
    found = {"albedo": score.raw, "after a gain": score.best, "unseen skin": score.unseen}
    return found | {"normals": judge.relief(avatar)}


def judging(name: str, data: Path, cache: Path, run: Row, photo: bytes, output: Path) -> Row:
    """A run, made and judged."""
    return make(run, photo, output, functools.partial(judged, name, data, cache))


def several(files: Sequence[bytes], counts: Sequence[int]) -> list[str]:
    """A table of drafts of the first so many photos, and the line through their processor seconds."""
    plain = Row("draft", Options(quality="draft", face="largest"))
    rows = [replace(isolated(make, plain, list(files[:count]), None), label=f"{count}") for count in counts]
    found = line(counts, [row.processor_s for row in rows])
    text = ["", "| photos, at `draft` | s | processor s | peak MiB |", "|---|---|---|---|"]
    text += [f"| {row.label} | {row.seconds:.1f} | {row.processor_s:.1f} | {row.peak_mb:.0f} |" for row in rows]
    if found is not None:
        text += ["", f"The straight line {found.start:.1f} + {found.slope:.2f} processor s a photo is off by "
                     f"{100 * found.worst:.0f} % at most."]  # fmt: skip
    return text


def draw(bench: Bench, path: Path) -> None:
    """Write a plot of how far normals are from the last run's against processor seconds as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axis = figure.subplots()
    # An identical map has a place on the logarithmic axis.
    rows = [(row.processor_s, max(row.losses["specular_normal"], 1e-4), row) for row in bench.rows if row.losses]
    points = sorted(rows, key=lambda one: one[:2])
    front = [(seconds, loss) for seconds, loss, row in points if row.front]
    axis.plot([seconds for seconds, _ in front], [loss for _, loss in front], "-", color="tab:red", linewidth=1)
    for seconds, loss, row in points:
        axis.plot(seconds, loss, "o", color="tab:red" if row.front else "tab:gray", markersize=7 if row.front else 4)
        place = (4, 5) if row.front else (4, -9)
        axis.annotate(row.label, (seconds, loss), fontsize=7, xytext=place, rotation=30, textcoords="offset points")
    axis.set_xlabel("processor seconds from the photo to the archive")
    axis.set_xscale("log")
    axis.set_ylabel("specular normals: mean angle to the reference, degrees")
    axis.set_yscale("log")
    axis.margins(x=0.18, y=0.18)
    axis.grid(alpha=0.3)
    figure.savefig(path, dpi=90, metadata={"Software": None})


def per_tile(compute: Callable[[Float32], object], maps: Float32, lanes: int) -> float:
    """Seconds that each of so many inputs takes that are computed at once; the best of three tries."""
    taken = []
    with ThreadPoolExecutor(lanes) as pool:
        list(pool.map(compute, [maps] * lanes))
        for _ in range(3):
            begin = time.perf_counter()
            list(pool.map(compute, [maps] * lanes))
            taken.append((time.perf_counter() - begin) / lanes)
    return min(taken)


def rates(precision: str) -> tuple[float, float]:
    """FLOP a second of a matrix product, and bytes a second that a copy reads and writes."""
    import torch

    factor = torch.ones(3072, 3072, dtype=torch.bfloat16 if precision == "bf16" else torch.float32)
    block = np.ones((1, 1, 1, 1 << 26), np.float32)
    product = per_tile(lambda maps: factor @ factor, block, 1)
    return 2 * 3072**3 / product, 2 * block.nbytes / per_tile(np.copy, block, 1)


def network_rows() -> list[str]:
    """A table of the networks of ``standard``: milliseconds of a tile, and of the whole map in PyTorch and here."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    from export.networks.convert import parts_of
    from models.networks.configs import build

    engine, plain = choose_engine(), choose_engine("onnxruntime")
    torch.set_num_threads(engine.threads)
    product, copy = rates(engine.precision)
    lines = [
        f"{engine.runtime} {engine.precision}, {engine.threads} threads; a matrix product {product / 1e9:.0f} GFLOP/s, "
        f"a copy {copy / 1e9:.1f} GB/s", "",
        "| network | tiles of a map | ms a tile | onnxruntime | PyTorch | times eager | floor, ms | times its floor |",
        "|---" * 8 + "|",
    ]  # fmt: skip
    eager, here = 0.0, 0.0
    for family in ("zeta", "delta_context", "delta", "psi", "rho", "sigma"):
        for part in parts_of(family, build(family).eval()):
            with open_network(part.name, engine) as own, open_network(part.name, plain) as other:
                what, (wide, high) = own.description, FULL_SIZE
                wide, high, inner = wide // what.scale, high // what.scale, DEFAULT_TILE // what.scale
                size = what.whole or (inner + 2 * what.margin,) * 2
                count = 1 if what.whole else len(tiles(wide, high, inner, what.stride))
                drawn = np.random.default_rng(0).uniform(-1, 1, (len(what.channels), size[1], size[0]))
                maps = np.asarray(drawn, np.float32)
                taken = [per_tile(one.run, maps, one.lanes) for one in (own, other)]
                tensor = torch.from_numpy(maps)[None]
                with torch.inference_mode(), FlopCounterMode(display=False) as counter:
                    moved = 4 * (tensor.numel() + part.module(tensor).numel())
                with torch.inference_mode():
                    taken.append(per_tile(lambda maps: part.module(tensor), maps, 1))  # noqa: B023
            floor = max(counter.get_total_flops() / product, moved / copy)
            eager, here = eager + count * taken[2], here + count * taken[0]
            cells = [*(1e3 * one for one in taken), taken[2] / taken[0], 1e3 * floor, taken[0] / floor]
            lines.append(f"| {part.name} | {count} | " + " | ".join(f"{one:.1f}" for one in cells) + " |")
    lines += ["", f"All tiles of a standard: {here:.1f} s, in PyTorch eager {eager:.1f} s: {eager / here:.1f} times."]
    return lines


def outside_networks() -> str:
    """What of a standard of the sample photo passes while no network of the maps computes."""
    spans, load = list[tuple[float, float]](), networks.load_network

    def watched(name: str, engine: Engine) -> networks.Loaded:
        what, compute = load(name, engine)

        def timed(maps: Float32) -> Float32:
            begin = time.perf_counter()
            try:
                return compute(maps)
            finally:
                spans.append((begin, time.perf_counter()))

        return what, timed

    networks.load_network = watched
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        write_archive(make_avatar(diagnosis.SAMPLE.read_bytes(), Options()), Path(folder) / "avatar.zip")
    seconds, busy, end = time.perf_counter() - begin, 0.0, 0.0
    for first, last in sorted(spans):
        busy, end = busy + max(last - max(first, end), 0.0), max(end, last)
    return f"A standard: {seconds:.1f} s, of these a network computes {busy:.1f} s, and none {seconds - busy:.1f} s."


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Folder that keeps what was rendered.")] = None,
    quick: Annotated[bool, typer.Option(help="Three small runs, and no more than two photos.")] = False,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into, with a plot.")] = None,
    of_networks: Annotated[bool, typer.Option("--networks", help="Measure the networks of the maps instead.")] = False,
) -> None:
    """Print the tables."""
    if of_networks:
        print(isolated(outside_networks), flush=True)
        print(*network_rows(), sep="\n")
        return
    from benchmarks.corrections.__main__ import CACHE
    from benchmarks.corrections.photos import photos
    from benchmarks.shoot import data_folder

    folder, cache = data_folder(None if data is None else str(data)), cache or CACHE
    cache.mkdir(parents=True, exist_ok=True)
    taken = {one.name: one.data for one in photos(folder, cache, SAME_PERSON)}
    bench = run_bench(
        runs(quick=quick), photo=taken[PHOTO], making=functools.partial(judging, PHOTO, folder, cache),
        progress=lambda label, done: typer.echo(f"{100 * done:.0f} % {label}", err=True),
    )  # fmt: skip
    counts = COUNTS[:2] if quick else COUNTS
    tell("\n".join([as_markdown(bench), *several([taken[name] for name in SAME_PERSON], counts)]), MARK, write)
    if write is not None:
        draw(bench, write.with_suffix(".png"))


if __name__ == "__main__":
    typer.run(main)
