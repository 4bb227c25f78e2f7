"""Draws captures of the light stage into files for training: ``python -m models.training.factory -o DIR``.

Files that exist are left alone, so an interrupted run goes on where it stopped, and several processes can share the
work by ``--jobs``. On a machine with an accelerator give ``--device cuda``.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import count as upwards
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer

from models.lightstage.poses import EXPRESSIONS
from models.lightstage.split import FIRST_SEED, HELD_OUT, TRAIN, subject_part
from models.lightstage.tones import TONES, tone
from models.training.capture import LIGHTS, Recipe, Sitting, Studio, capture
from service.errors import UsageError


def pose_of(seed: int, round_: int) -> str:
    """The expression of a subject in a round; every subject goes through all of them."""
    return EXPRESSIONS[(seed * 3 + round_) % len(EXPRESSIONS)]


def seeds_of(part: str, first: int = FIRST_SEED, tone_class: str | None = None) -> Iterator[int]:
    """Seeds of a part of the split from ``first`` on, without end; of one class of skin tone if that is asked for.

    Raises:
        UsageError: there is no such part or tone.
    """
    names = [name for name, _, _ in TONES]
    if part not in (TRAIN, HELD_OUT):
        raise UsageError(f"part is {part!r}; it has to be {TRAIN!r} or {HELD_OUT!r}")
    if tone_class not in (None, *names):
        raise UsageError(f"tone is {tone_class!r}; it has to be one of: {', '.join(names)}")
    return (s for s in upwards(first) if subject_part(s) == part and tone_class in (None, tone(s)))


def draw(seed: int, pose: str, part: str, folder: Path, device: str, recipe: Recipe) -> Path | None:
    """Write one capture, whole or not at all; None where it was there already."""
    path = folder / part / f"{seed}_{pose}.npz"
    if path.exists():
        return None
    arrays = capture(Sitting.of(Studio.open(), seed, pose, part, device), recipe)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(f".{os.getpid()}.part")
    with unfinished.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)
    unfinished.replace(path)
    return path


def _share(seeds: list[int], round_: int, part: str, folder: Path, device: str, recipe: Recipe, threads: int) -> int:
    torch.set_num_threads(threads)
    written = 0
    for seed in seeds:
        begin = time.perf_counter()
        if draw(seed, pose_of(seed, round_), part, folder, device, recipe):
            written += 1
            typer.echo(f"{part} {seed} {pose_of(seed, round_)}: {time.perf_counter() - begin:.1f} s")
    return written


def main(
    output: Annotated[Path, typer.Option("-o", help="Folder for the captures.")],
    first: Annotated[int, typer.Option(help="First subject's seed.")] = FIRST_SEED,
    count: Annotated[int, typer.Option(min=1, help="Subjects of this part.")] = 140,
    part: Annotated[str, typer.Option(help="train or held-out.")] = TRAIN,
    tone_class: Annotated[str | None, typer.Option("--tone", help="Skin tone: dark, brown, tan or light.")] = None,
    rounds: Annotated[int, typer.Option(min=1, max=len(EXPRESSIONS), help="Expressions of each subject.")] = 1,
    jobs: Annotated[int, typer.Option(min=1)] = 1,
    threads: Annotated[int, typer.Option(min=1, help="Of each job.")] = 1,
    whole_only: Annotated[bool, typer.Option(help="No patches: a third of the time, for the context alone.")] = False,
    patches_only: Annotated[bool, typer.Option(help="No whole charts and no light: for psi alone.")] = False,
    lights: Annotated[int, typer.Option(min=1, help="Scenes of each whole chart; every other one is hard.")] = LIGHTS,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
) -> None:
    """Draw ``count`` subjects of a part of the split, each in ``rounds`` expressions.

    Raises:
        UsageError: there is no such part or tone, or nothing is left to draw.
    """
    if whole_only and patches_only:
        raise UsageError("--whole-only and --patches-only leave nothing to draw; give one of them")
    recipe = Recipe(lights, block=0, draft_width=0) if whole_only else Recipe(lights)
    recipe = Recipe(lights=0, lit=0) if patches_only else recipe
    seeds = list(islice(seeds_of(part, first, tone_class), count))
    for round_ in range(rounds):
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            shares = [seeds[i::jobs] for i in range(jobs)]
            work = [
                pool.submit(_share, share, round_, part, output, device, recipe, threads) for share in shares if share
            ]
            written = sum(job.result() for job in work)
        typer.echo(f"round {round_}: {written} written, {len(seeds) - written} there already")


if __name__ == "__main__":
    typer.run(main)
