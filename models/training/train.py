r"""Trains one network: ``python -m models.training.train rho --data DIR --steps 4000``.

A run writes into its folder: ``checkpoint.pt`` (weights, their moving average, optimiser, random state, step, and the
run's settings: started again with the same folder, it goes on), ``log.jsonl`` (a line per measurement on held-out
subjects), ``sheet.png`` (held-out results beside the truth).

On several accelerators or machines, which share the folders of captures and of the run::

    torchrun --nnodes 1:4 --nproc-per-node 8 --max-restarts 9 --rdzv-backend c10d --rdzv-endpoint HOST:29400 \
        -m models.training.train rho --data DIR --device cuda -o DIR

each step then has ``--parts`` batches, which the processes share (:mod:`models.training.team`). Where a machine is
lost, the others go on from the last checkpoint; not so where it is HOST.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import torch
import typer
from torch import Tensor

from models.networks.configs import NETWORKS, parameters
from models.networks.stages import DeltaBlind
from models.training.albedo import DeltaTask
from models.training.context import ContextTask
from models.training.normals import NormalTask
from models.training.specular_albedo import PsiTask
from models.training.super_resolution import ZetaTask
from models.training.tasks import Task
from models.training.team import joined
from models.training.trainer import Run, Trainer
from service.errors import UsageError

TASKS: dict[str, Callable[[Path, int], Task]] = {
    "delta_context": lambda data, _: ContextTask(data),
    "delta": lambda data, side: DeltaTask(data, side),
    "delta_blind": lambda data, side: DeltaTask(data, side, DeltaBlind.channels),
    "psi": lambda data, side: PsiTask(data, side),
    "rho": lambda data, side: NormalTask(data, "specular_normal", side),
    "sigma": lambda data, side: NormalTask(data, "diffuse_normal", side),
    "zeta": lambda data, side: ZetaTask(data, max(side // 8, 16)),
}


def write_sheet(sheet: Tensor, path: Path) -> None:
    """(3, h, w) in [0, 1] -> PNG."""
    image = (sheet.clamp(0.0, 1.0) * 255.0).byte().permute(1, 2, 0).numpy()[..., ::-1]
    cv2.imwrite(str(path), np.ascontiguousarray(image))


def go(trainer: Trainer, folder: Path, every: int, minutes: float) -> None:
    """Train until the steps are done or the time is up, measuring now and then; the first of a team measures."""
    run, begin, before = trainer.run, time.perf_counter(), trainer.seconds
    losses: dict[str, list[float]] = defaultdict(list)
    while trainer.step < run.steps:
        for name, value in trainer.train_step().items():
            losses[name].append(value)
        trainer.seconds = before + time.perf_counter() - begin
        late = trainer.team.told((time.perf_counter() - begin) > 60.0 * minutes)
        if trainer.step % every and not late and trainer.step < run.steps:
            continue
        if trainer.team.leads:
            _report(trainer, folder, losses)
        losses.clear()
        trainer.task.refresh()
        if late:
            break


def _report(trainer: Trainer, folder: Path, losses: dict[str, list[float]]) -> None:
    """Measure, write it down, and save."""
    numbers, sheet = trainer.measure()
    line = {
        "step": trainer.step, "seconds": round(trainer.seconds), "rate": trainer.rate(),
        "loss": {name: round(float(np.mean(values)), 5) for name, values in losses.items()}, "held_out": numbers,
    }  # fmt: skip
    with (folder / "log.jsonl").open("a", encoding="utf-8") as log:
        log.write(json.dumps(line) + "\n")
    typer.echo(json.dumps(line))
    write_sheet(sheet, folder / "sheet.png")
    trainer.save(folder)


def main(
    network: Annotated[str, typer.Argument(help=f"One of: {', '.join(NETWORKS)}.")],
    data: Annotated[Path, typer.Option(help="Folder of captures.")],
    config: Annotated[str, typer.Option(help="slim, compact, wide or paper.")] = "compact",
    output: Annotated[Path | None, typer.Option("-o", help="Folder of the run.")] = None,
    steps: Annotated[int, typer.Option(min=1)] = 4000,
    batch: Annotated[int, typer.Option(min=1)] = 8,
    side: Annotated[int, typer.Option(min=64, help="Of a training crop, texels.")] = 256,
    rate: Annotated[float, typer.Option(help="Adam's learning rate.")] = 4e-4,
    seed: int = 1,
    every: Annotated[int, typer.Option(min=1, help="Steps between measurements and checkpoints.")] = 200,
    minutes: Annotated[float, typer.Option(help="Stop after this time; start again to go on.")] = 1e9,
    adversarial_from: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of the steps without it.")] = 0.6,
    adversarial_weight: Annotated[float, typer.Option(min=0.0, help="0 trains without a discriminator.")] = 0.0,
    begin_with: Annotated[Path | None, typer.Option(help="Run whose weights a new one begins with.")] = None,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    bf16: Annotated[bool, typer.Option(help="Half precision: faster on a CPU with AVX-512 BF16 or AMX.")] = False,
    parts: Annotated[int, typer.Option(min=0, help="Batches of a step; 0: one for each process of torchrun.")] = 0,
) -> None:
    """Train a network, or go on with its training.

    Raises:
        UsageError: there is no such network, or there are more processes than parts of a step.
    """
    if network not in TASKS:
        raise UsageError(f"network is {network!r}; there are {', '.join(TASKS)}")
    if adversarial_weight > 0.0 and network != "zeta":
        raise UsageError("adversarial_weight is for zeta; the other networks have one right answer")
    torch.set_num_threads(threads)
    if network == "delta_context" and device != "cpu":  # its charts are painted where it learns
        torch.set_default_device(device)
    folder = output or Path("build/training") / f"{network}_{config}"
    folder.mkdir(parents=True, exist_ok=True)
    task = TASKS[network](data, side)
    task.refresh()
    with joined(device) as (team, own):
        settings = (steps, batch, side, rate, seed, adversarial_from, adversarial_weight)
        trainer = Trainer(Run(network, config, *settings, parts or team.size), task, own, bf16, team)
        if (folder / "checkpoint.pt").exists():
            trainer.load(folder)
        elif begin_with is not None:
            fresh = trainer.begin_with(begin_with)
            typer.echo(f"begins with {begin_with}; fresh: {', '.join(fresh) or 'nothing'}")
        if trainer.run.parts < team.size:
            raise UsageError(f"a step of this run has {trainer.run.parts} parts, too few for {team.size} processes")
        if team.leads:
            count = parameters(trainer.network)
            typer.echo(f"{network} {config}: {count} parameters, step {trainer.step} of {steps}, {team.size} at work")
        go(trainer, folder, every, minutes)


if __name__ == "__main__":
    typer.run(main)
