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

from benchmarks.albedo import albedo_of
from benchmarks.corrections.__main__ import CACHE
from benchmarks.corrections.photos import photos
from benchmarks.corrections.score import Judge
from benchmarks.shoot import data_folder
from models.tables import tell
from service.archive.avatar import Avatar
from service.bench.report import MARK, as_markdown, draw
from service.bench.runs import Row, isolated, line, make, run_bench, runs
from service.options import Options

PHOTO = "ffhq_soft"
SAME_PERSON = (PHOTO, "ffhq_left", "ffhq_soft film", "ffhq_left red blown")
"""Photos of one sitter, of which the first so many are given."""
COUNTS = (1, 2, 3, 4)


def judged(name: str, data: Path, cache: Path, avatar: Avatar) -> Mapping[str, float]:
    """Decibels of what a photo of the trial tells: seen skin as it is and after the best gain, unseen skin, normals."""
    photo = next(photos(data, cache, [name]))
    judge = Judge.of(photo, avatar)
    score = judge.score(albedo_of(avatar.reflectance))
    found = {"albedo": score.raw, "after a gain": score.best, "unseen skin": score.unseen}
    return found | {"normals": judge.relief(avatar)}


def judging(name: str, data: Path, cache: Path, run: Row, photo: bytes, output: Path) -> Row:
    """A run, made and judged."""
    return make(run, photo, output, functools.partial(judged, name, data, cache))


def several(files: Sequence[bytes], counts: Sequence[int]) -> list[str]:
    """A table of drafts of the first so many photos, and the line through their seconds."""
    plain = Row("draft", Options(quality="draft", face="largest"))
    rows = [replace(isolated(make, plain, list(files[:count]), None), label=f"{count}") for count in counts]
    found = line(counts, [row.seconds for row in rows])
    text = ["", "| photos, at `draft` | s | processor s | peak MiB |", "|---|---|---|---|"]
    text += [f"| {row.label} | {row.seconds:.1f} | {row.processor_s:.1f} | {row.peak_mb:.0f} |" for row in rows]
    if found is not None:
        text += ["", f"The straight line {found.start:.1f} s + {found.slope:.2f} s a photo is off by "
                     f"{100 * found.worst:.0f} % at most."]  # fmt: skip
    return text


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    quick: Annotated[bool, typer.Option(help="Three small runs, and no more than two photos.")] = False,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into, with a plot.")] = None,
) -> None:
    """Print the tables."""
    folder = data_folder(None if data is None else str(data))
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
