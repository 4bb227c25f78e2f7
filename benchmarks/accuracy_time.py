"""What accuracy costs in time, through the product: ``python -m benchmarks.accuracy_time --data DIR [--write FILE]``.

Each quality of ``make_avatar`` runs on the same rendered photos with known albedo
(``benchmarks.corrections.photos``), in turn, so that the times are ratios of one run. ``--write`` puts the table
between the lines ``<!-- truth -->`` and ``<!-- /truth -->`` of a Markdown file.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.corrections.__main__ import CACHE
from benchmarks.corrections.photos import QUICK, photos
from benchmarks.corrections.score import Judge, Score
from benchmarks.shoot import data_folder
from models.tables import tell
from service.bench.losses import pareto
from service.colour import FULL_CODE
from service.levels import LEVELS
from service.options import Options
from service.pipeline import make_avatar

MARK = ("<!-- truth -->", "<!-- /truth -->")
MAPS = ("diffuse_albedo", "specular_normal")
RUNTIMES = ("onnxruntime", "openvino")


@dataclass(frozen=True)
class Point:
    """One way to make avatars.

    Attributes:
        quality, runtime: as the options name them.
        seconds: mean wall time of ``make_avatar`` over the photos.
        albedo: mean score of the diffuse albedo on seen skin.
        relief: mean PSNR of the specular normals, dB.
    """

    quality: str
    runtime: str
    seconds: float
    albedo: Score
    relief: float


def measured(
    data: Path, cache: Path, qualities: Sequence[str], runtimes: Sequence[str]
) -> tuple[list[Point], Score]:
    """All points, and the score of one flat colour, which is the mean of the true albedo."""
    found: dict[tuple[str, str], list[tuple[float, Score, float]]] = {(q, r): [] for q in qualities for r in runtimes}
    flat = []
    for photo in photos(data, cache, QUICK):
        for (quality, runtime), results in found.items():
            asked: dict[str, Any] = {"quality": quality, "runtime": runtime}
            begin = time.perf_counter()
            avatar = make_avatar(photo.data, Options(maps=MAPS, face="largest", **asked))
            seconds = time.perf_counter() - begin
            judge = Judge.of(photo, avatar)
            if avatar.reflectance is None or avatar.reflectance.diffuse_albedo is None:
                raise SystemExit(f"{photo.name} came back without its diffuse albedo")
            albedo = np.asarray(avatar.reflectance.diffuse_albedo, np.float32) / FULL_CODE
            results.append((seconds, judge.score(albedo), judge.relief(avatar)))
            typer.echo(f"{photo.name}, {quality}, {runtime}: {seconds:.1f} s", err=True)
        flat.append(judge.flat())
    points = []
    for (quality, runtime), results in found.items():
        times, scores, relief = zip(*results, strict=True)
        points.append(Point(quality, runtime, float(np.mean(times)), mean(scores), float(np.mean(relief))))
    return points, mean(flat)


def mean(scores: Sequence[Score]) -> Score:
    """Of each figure over the photos that have it; NaN where none has."""
    rows = np.array([[one.best, one.raw, one.delta_e, one.unseen] for one in scores])
    known = np.isfinite(rows)
    total = np.where(known, rows, 0).sum(0)
    return Score(*(float(a / n) if n else float("nan") for a, n in zip(total, known.sum(0), strict=True)))


def table(points: Sequence[Point], flat: Score) -> list[str]:
    """Markdown; on the front is what no other way beats in both time and truth."""
    fastest = min(point.seconds for point in points)
    front = pareto([(point.seconds, -round(point.albedo.best + point.relief, 2)) for point in points])
    lines = [
        "| quality | runtime | s | x fastest | albedo dB, best gain | raw | Delta E 2000 | normals dB | front |",
        "|---" * 9 + "|",
    ]
    for point, best in zip(points, front, strict=True):
        head = f"| {point.quality} | {point.runtime} | {point.seconds:.1f} | {point.seconds / fastest:.2f} | "
        lines.append(f"{head}{_told(point.albedo)} | {point.relief:.2f} | {'**front**' if best else ''} |")
    lines.append(f"| one flat colour, the true mean | | | | {_told(flat)} | | |")
    return [*lines, "", f"Means over {len(QUICK)} rendered photos: {', '.join(QUICK)}."]


def _told(albedo: Score) -> str:
    """Three cells."""
    return f"{albedo.best:.2f} | {albedo.raw:.2f} | {albedo.delta_e:.2f}"


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    quality: Annotated[str, typer.Option(help="Names, with commas between.")] = ",".join(LEVELS),
    runtime: Annotated[str, typer.Option(help="Names, with commas between.")] = ",".join(RUNTIMES),
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    folder = data_folder(None if data is None else str(data))
    points, flat = measured(folder, cache, quality.split(","), runtime.split(","))
    tell("\n".join(table(points, flat)), MARK, write)


if __name__ == "__main__":
    typer.run(main)
