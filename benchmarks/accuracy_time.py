"""What accuracy costs in time, against the truth: ``python -m benchmarks.accuracy_time --data DIR [--write FILE]``.

The runs of ``avatarme bench`` on a rendered photo whose head and albedo are known, one of ``benchmarks.corrections``
(DIR is its folder). To the table of that command this adds how far albedo and normals are from the truth, by which the
Pareto front is told, and seconds against the number of photos of one person.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from models.tables import tell
from service.archive.avatar import Avatar
from service.bench.report import as_markdown
from service.bench.runs import Bench, Row, isolated, line, make, run_bench, runs
from service.options import Options

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


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Folder that keeps what was rendered.")] = None,
    quick: Annotated[bool, typer.Option(help="Three small runs, and no more than two photos.")] = False,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into, with a plot.")] = None,
) -> None:
    """Print the tables."""
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
