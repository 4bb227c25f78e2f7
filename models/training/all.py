"""Makes data and trains all networks of the reflectance in a given time.

``python -m models.training.all --minutes 60 [--device auto]``.

A share of the time goes into captures of the light stage, the rest into the networks in turn, each in a run of its own
(``models.training.train``) that begins with the weights of the service where those are of its size. Started again with
the same folder it draws further captures and goes on with the runs; nothing but the tree is needed, on a CPU or CUDA.
The networks are then measured, compared and converted by hand (docs/training.md): more training is not always better.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import torch
import typer

from models.lightstage.split import HELD_OUT, TRAIN
from models.networks.configs import CONFIGS
from models.training.capture import Recipe
from models.training.factory import draw, pose_of, seeds_of
from models.training.restore import restored
from models.training.train import TASKS, go
from models.training.trainer import Run, Trainer
from service.errors import ModelFault, UsageError

DRAWING = 0.4
"""Share of the time for captures."""

SHARES = {"delta_context": 0.3, "delta": 0.2, "rho": 0.15, "sigma": 0.1, "psi": 0.05, "zeta": 0.2}
"""Share of the rest of each network."""

HELD_OUT_EVERY = 8
"""Of so many captures one is of the held-out part."""

RATE, BATCH, SIDE, EVERY, STEPS = 3e-4, 6, 256, 100, 100_000
"""Of each run; its steps are more than any time allows, so that the rate stays as it is."""

Clock = Callable[[], float]


def device_named(name: str) -> str:
    """``cpu`` or ``cuda``; for ``auto`` the accelerator where there is one.

    Raises:
        UsageError: the name is none of these, or there is no accelerator.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise UsageError(f"device is {name!r}; it has to be auto, cpu or cuda")
    found = torch.cuda.is_available()
    if name == "cuda" and not found:
        raise UsageError("device is 'cuda', but torch finds no accelerator here; auto or cpu would run")
    return ("cuda" if found else "cpu") if name == "auto" else name


def turns() -> Iterator[tuple[int, str]]:
    """Seed and part of capture after capture, without end: held-out ones among those for training."""
    parts = {part: seeds_of(part) for part in (TRAIN, HELD_OUT)}
    number = 0
    while True:
        part = HELD_OUT if number % HELD_OUT_EVERY == 1 else TRAIN
        yield next(parts[part]), part
        number += 1


def captured(folder: Path, device: str, seconds: float, clock: Clock = time.monotonic) -> int:
    """Draw captures until the time is up, at least one of each part; how many are new."""
    end, written, there = clock() + seconds, 0, {TRAIN: 0, HELD_OUT: 0}
    for seed, part in turns():
        if clock() >= end and all(there.values()):
            return written
        if draw(seed, pose_of(seed, 0), part, folder, device, Recipe()) is not None:
            written += 1
            typer.echo(f"{part} {seed}")
        there[part] += 1
    return written


def trainer_of(network: str, config: str, data: Path, folder: Path, device: str, bf16: bool) -> Trainer:
    """A run that goes on from its folder, or begins with the service's weights, or with none where these do not fit."""
    task = TASKS[network](data, SIDE)
    task.refresh()
    weight = 0.01 if network == "zeta" else 0.0
    trainer = Trainer(Run(network, config, STEPS, BATCH, SIDE, RATE, 1, 0.0, weight), task, device, bf16)
    if (folder / "checkpoint.pt").exists():
        trainer.load(folder)
        return trainer
    try:
        trainer.take(restored(network, config))
    except ModelFault as fault:
        typer.echo(f"{network} begins with random weights: {fault}")
    return trainer


def main(
    minutes: Annotated[float, typer.Option(min=0.1, help="Time for everything.")],
    output: Annotated[Path, typer.Option("-o", help="Folder for captures and runs.")] = Path("build/all"),
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    config: Annotated[str, typer.Option(help=f"Size of the networks: {', '.join(CONFIGS)}.")] = "compact",
    networks: Annotated[str, typer.Option(help="With commas between.")] = ",".join(SHARES),
    threads: Annotated[int, typer.Option(min=1)] = 1,
    bf16: Annotated[bool, typer.Option(help="Half precision: faster on a CPU with AVX-512 BF16 or AMX.")] = False,
) -> None:
    """Draw captures, then train.

    Raises:
        UsageError: there is no such device, size or network.
    """
    where, chosen = device_named(device), list(dict.fromkeys(networks.split(",")))
    if config not in CONFIGS or not set(chosen) <= set(SHARES):
        raise UsageError(f"{config!r}, {networks!r}: sizes are {', '.join(CONFIGS)}; networks {', '.join(SHARES)}")
    torch.set_num_threads(threads)
    begin, data = time.monotonic(), output / "captures"
    new = captured(data, where, 60.0 * minutes * DRAWING)
    typer.echo(f"{new} new captures in {(time.monotonic() - begin) / 60:.1f} minutes, on {where}")
    for number, network in enumerate(chosen):
        # What one network leaves or overdraws is shared by those that follow.
        left = minutes - (time.monotonic() - begin) / 60.0
        share = SHARES[network] / sum(SHARES[name] for name in chosen[number:])
        folder = output / f"{network}_{config}"
        folder.mkdir(parents=True, exist_ok=True)
        trainer = trainer_of(network, config, data, folder, where, bf16)
        first = trainer.step
        go(trainer, folder, EVERY, max(left * share, 0.0))
        typer.echo(f"{network}: {trainer.step - first} steps more, {trainer.step} in all")
    typer.echo(
        f"{(time.monotonic() - begin) / 60:.1f} minutes in all; next: models.training.evaluate, benchmarks.albedo"
    )


if __name__ == "__main__":
    typer.run(main)
