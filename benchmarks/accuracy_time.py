"""What accuracy costs in time against known truth: ``python -m benchmarks.accuracy_time --captures DIR``.

DIR has the folder ``held-out`` of captures of the light stage (``python -m models.training.factory``): subjects and
lights that no training has seen. Every network runs over the same crops in every precision and size that
``avatarme bench`` tries; loss is told against the truth, time beside that of the same network in PyTorch, eager, in the
same run. ``--write FILE`` puts the tables between the lines ``<!-- truth -->`` and ``<!-- /truth -->`` of a Markdown
file.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol, cast

import numpy as np
import torch
import typer
from torch import Tensor, nn

from models.networks.configs import build
from models.tables import tell
from models.training.evaluate import single
from models.training.store import Patches
from models.training.tasks import Batch, Task
from models.training.train import TASKS
from service.bench.pareto import pareto
from service.bench.rates import best_of
from service.bench.variants import FULL, INT8, SHIPPED, Precision, precisions
from service.cli.bench import find_families
from service.errors import ModelFault, UsageError
from service.runtime.networks import Engine, Network, choose_engine, open_network
from service.runtime.sessions import model_table

MARK = ("<!-- truth -->", "<!-- /truth -->")
NETWORKS = ("delta", "psi", "rho", "sigma")
UNITS = {"delta": "dB", "psi": "mean absolute error", "rho": "degrees", "sigma": "degrees"}
SIDE = 256
TIMED = 512
"""Side of the square that is timed, in pixels."""


class HeldOut(Task, Protocol):
    """A task on patches."""

    test: Patches


@dataclass(frozen=True)
class Runs:
    """A loaded network, called as torch modules are."""

    network: Network

    def __call__(self, maps: Tensor) -> Tensor:
        """(N, C, h, w) -> (N, K, h', w')."""
        return torch.stack([torch.from_numpy(self.network.run(item.numpy())) for item in maps])


@dataclass(frozen=True)
class Point:
    """One network in one variant: mean score of its task (larger is better), seconds of ``TIMED`` squared pixels."""

    label: str
    score: float
    seconds: float


def engines(threads: int, further: Path | None) -> Iterator[tuple[str, Engine]]:
    """Labels and engines: the shipped networks in every precision but int8, other sizes in fp32."""
    first, *others = find_families(further)
    yield f"{first.name}, onnxruntime fp32", Engine(threads=threads, folder=first.folder)
    for runtime, precision in precisions(FULL):
        if precision not in INT8:
            computed: Precision = precision
            chosen = Engine(runtime, "bf16" if computed == "bf16" else "fp32", threads, first.folder)
            yield f"{first.name}, {runtime} {computed}", chosen
    for family in others:
        yield f"{family.name}, onnxruntime fp32", Engine(threads=threads, folder=family.folder)


def score(task: Task, network: Runs, batches: list[Batch]) -> float:
    """Mean of the task's score over crops.

    Raises:
        ModelFault: there are no crops.
    """
    if not batches:
        raise ModelFault("the captures have no crop for this network; draw more with models.training.factory")
    with torch.no_grad():
        return float(
            np.mean([task.measure(task.predict(cast(nn.Module, network), batch), batch)["score"] for batch in batches])
        )


def quantised(name: str, first: Engine, batch: Tensor, scratch: Path) -> Iterator[tuple[str, Engine]]:
    """The network in eight bits, ranges from a held-out crop; nothing where the package onnx is not installed."""
    from service.bench import quantise

    if not quantise.available():
        return
    for precision in INT8:
        target = scratch / f"{name}-{precision.replace(' ', '-')}"
        target.mkdir()
        maps = batch.numpy() if precision == "int8 static" else None
        quantise.write_folder([(name, maps)], first, target)
        yield f"{SHIPPED}, onnxruntime {precision}", Engine(threads=first.threads, folder=target)


class _Heard:
    """Keeps what a task would show a network."""

    heard: Tensor | None = None

    def __call__(self, maps: Tensor) -> Tensor:
        """(N, C, h, w) -> (N, 3, h, w) zeros."""
        self.heard = maps
        return maps[:, :1].expand(-1, 3, -1, -1) * 0.0


def heard(task: Task, batch: Batch) -> Tensor:
    """(N, C, h, w) that the network of a task is shown for a batch."""
    ear = _Heard()
    task.predict(cast(nn.Module, ear), batch)
    if ear.heard is None:
        raise ModelFault("the task has shown the network nothing")
    return ear.heard


def points(name: str, data: Path, config: str, threads: int, further: Path | None) -> list[Point]:
    """All variants of one network, PyTorch last."""
    task = cast(HeldOut, TASKS[name](data, SIDE))
    task.test.refresh()  # captures for training are not needed
    batches = single(task.held_out())
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        listed = [*engines(threads, further)]
        listed += quantised(name, listed[0][1], heard(task, batches[0]), Path(scratch))
        for label, engine in listed:
            if name not in model_table(engine.folder):
                continue
            with open_network(name, engine) as network:
                maps = np.zeros((len(network.description.channels), TIMED, TIMED), np.float32)
                network.run(maps)
                seconds = best_of(3, lambda: network.run(maps))  # noqa: B023 - called at once
                found.append(Point(label, score(task, Runs(network), batches), seconds))
    eager = build(name, config).eval()
    example = torch.zeros(1, len(cast(tuple[str, ...], eager.channels)), TIMED, TIMED)
    with torch.no_grad():
        eager(example)
        found.append(Point(f"PyTorch eager fp32, {config}", float("nan"), best_of(3, lambda: eager(example))))
    return found


def table(name: str, found: list[Point]) -> list[str]:
    """Markdown."""
    eager = found[-1].seconds
    front = pareto([(point.seconds, -point.score) for point in found])
    lines = [
        f"**{name}**",
        "",
        f"| variant | {UNITS[name]} | s / {TIMED}² | x PyTorch eager | front |",
        "|---" * 5 + "|",
    ]
    for point, best in zip(found, front, strict=True):
        told = "-" if np.isnan(point.score) else f"{abs(point.score):.4g}"
        times = f"{point.seconds:.3f} | {eager / point.seconds:.2f}"
        lines.append(f"| {point.label} | {told} | {times} | {'**front**' if best else ''} |")
    return [*lines, ""]


def main(
    captures: Annotated[Path, typer.Option(help="Folder of captures; its folder held-out is used.")],
    networks: Annotated[Path | None, typer.Option(help="Networks of other sizes, as for avatarme bench.")] = None,
    config: Annotated[str, typer.Option(help="Size of the shipped networks, for PyTorch.")] = "compact",
    only: Annotated[str, typer.Option(help="Names, with commas between.")] = ",".join(NETWORKS),
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    data = captures.parent if captures.name == "held-out" else captures
    threads = choose_engine().threads
    torch.set_num_threads(threads)
    lines: list[str] = []
    for name in only.split(","):
        if name not in NETWORKS:
            raise UsageError(f"only has {name!r}; there are {', '.join(NETWORKS)}")
        lines += table(name, points(name, data, config, threads, networks))
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
