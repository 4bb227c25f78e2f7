"""Draws captures of the light stage into files for training: ``python -m models.training.factory -o DIR``.

Files that exist are left alone, so an interrupted run goes on where it stopped; ``--jobs`` draws several at the same
time, ``--database`` has them drawn on many machines (:mod:`models.drawing`). On an accelerator: ``--device cuda``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from itertools import count as upwards
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer

from models.drawing import draw_all
from models.lightstage.poses import EXPRESSIONS
from models.lightstage.split import FIRST_SEED, HELD_OUT, TRAIN, subject_part
from models.lightstage.tones import TONES, tone
from models.training.capture import LIGHTS, Arrays, Recipe, Sitting, Studio, capture
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
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(f".{os.getpid()}.part")
    _write(capture(Sitting.of(Studio.open(), seed, pose, part, device), recipe), unfinished)
    unfinished.replace(path)
    return path


def draw_order(order: Mapping[str, Any], target: Path) -> None:
    """Draw one capture: ``seed``, ``pose``, ``part``, ``device``, ``threads``, and ``recipe`` as of :class:`Recipe`."""
    torch.set_num_threads(order["threads"])
    sitting = Sitting.of(Studio.open(), order["seed"], order["pose"], order["part"], order["device"])
    _write(capture(sitting, Recipe(**order["recipe"])), target)


def _write(arrays: Arrays, path: Path) -> None:
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def main(
    output: Annotated[str, typer.Option("-o", "--out", help="Folder or s3:// address for the captures.")],
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
    database: Annotated[str, typer.Option(help="Have them drawn by workers of this Postgres: models/drawing.py.")] = "",
) -> None:
    """Draw ``count`` subjects of a part of the split, each in ``rounds`` expressions.

    Raises:
        UsageError: there is no such part or tone, or nothing is left to draw.
    """
    if whole_only and patches_only:
        raise UsageError("--whole-only and --patches-only leave nothing to draw; give one of them")
    recipe = Recipe(lights, block=0, draft_width=0) if whole_only else Recipe(lights)
    recipe = Recipe(lights=0, lit=0) if patches_only else recipe
    more = {"what": "captures", "part": part, "device": device, "threads": threads, "recipe": asdict(recipe)}
    poses = ((s, pose_of(s, n)) for n in range(rounds) for s in islice(seeds_of(part, first, tone_class), count))
    orders = {f"{part}/{seed}_{pose}.npz": {"seed": seed, "pose": pose, **more} for seed, pose in poses}
    if not draw_all(orders, output, jobs=jobs, database=database):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
