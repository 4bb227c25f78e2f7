"""The shipped networks on every runtime, beside PyTorch: ``python -m benchmarks.runtimes``.

Each network runs on the same input in PyTorch (eager, fp32), onnxruntime and, where it is installed, OpenVINO, one
after the other in every round; the fastest round of each counts. Seconds are those of a full set of maps of
6144 x 4096, halos included. The last lines are the sums with and without OpenVINO, and what ``--runtime auto`` chooses;
where another runtime was faster by more than a tenth, a line says so. Needs torch, which serving does not.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import numpy as np
import torch
import typer
from torch import nn

from models.networks.configs import Zeta, build
from models.tables import tell
from service.levels import FULL_SIZE, TEXTURE_SIZE
from service.reflectance.reflectance_plan import ROLES, ReflectancePlan
from service.runtime.networks import Description, Engine, RuntimeName, choose_engine, describe_network, open_network
from service.runtime.sessions import has_openvino, model_table
from service.runtime.tiles import DEFAULT_TILE, tiles

MARK = ("<!-- runtimes -->", "<!-- /runtimes -->")
EAGER = "PyTorch"
SLOWER = 1.1
"""A choice is called wrong where another runtime needs less than one part in this of its time."""

Work = Callable[[], object]
Clock = Callable[[], float]


@dataclass(frozen=True)
class Timed:
    """One network: seconds of a full set of maps by way, and how far the runtimes' results are from PyTorch's."""

    name: str
    seconds: Mapping[str, float]
    chosen: str


def module(name: str, what: Description, config: str = "") -> nn.Module:
    """The network in PyTorch, fresh weights, of the size that the table of models names; or of ``config``.

    Raises:
        SystemExit: no network of that size takes the channels of the shipped one.
    """
    found = re.search(r"config (\w+)", str(model_table()[name]["source"]))
    size = config or (found[1] if found else "compact")
    role, _, part = name.partition("_") if name.startswith("zeta") else (name, "", "")
    candidates = [build(role, size)] + ([build("delta_blind", size)] if role == "delta" else [])
    for candidate in candidates:
        inner = getattr(cast(Zeta, candidate), part) if part else candidate
        width, height = what.whole or (8 * what.stride, 8 * what.stride)
        example = torch.zeros(1, len(what.channels), height, width)
        try:
            with torch.no_grad():
                inner.eval()(example)
        except RuntimeError:
            continue  # other channels
        return cast(nn.Module, inner)
    raise SystemExit(f"{name} takes {len(what.channels)} channels; no network of size {size} does")


def scale(name: str, what: Description, shape: tuple[int, int]) -> float:
    """How many inputs of ``shape`` (height, width) a full set of maps takes, halos included."""
    if what.whole is not None:
        return 1.0
    whole = TEXTURE_SIZE if name.startswith("zeta") else FULL_SIZE
    return computed(whole, DEFAULT_TILE // what.scale, what) / (shape[0] * shape[1])


def computed(size: tuple[int, int], tile: int, what: Description) -> int:
    """Pixels of input that a network computes for a map (width, height), halos included."""
    return sum(
        (one.bottom - one.top + 2 * what.margin) * (one.right - one.left + 2 * what.margin)
        for one in tiles(*size, tile, what.stride)
    )


def ways(name: str, what: Description, maps: np.ndarray, threads: int, config: str, held: ExitStack) -> dict[str, Work]:
    """What to time, by label."""
    eager, batch = module(name, what, config), torch.from_numpy(maps[None])

    def run_eager() -> object:
        with torch.no_grad():
            return eager(batch)

    found: dict[str, Work] = {EAGER: run_eager}
    runtimes: tuple[RuntimeName, ...] = ("onnxruntime", "openvino") if has_openvino() else ("onnxruntime",)
    for runtime in runtimes:
        engine = choose_engine(runtime, threads=threads)
        for precision in dict.fromkeys(("fp32", engine.precision)):
            one = held.enter_context(open_network(name, Engine(runtime, precision, threads)))
            found[f"{runtime} {precision}"] = lambda one=one: one.run(maps)  # type: ignore[misc]
    return found


def measure(
    name: str, threads: int, rounds: int, side: int, config: str = "", clock: Clock = time.perf_counter
) -> Timed:
    """Time one network on inputs of about ``side`` pixels."""
    what = describe_network(name)
    edge = side // what.scale // what.stride * what.stride
    shape = what.whole[::-1] if what.whole else (edge, edge)
    maps = np.random.default_rng(0).uniform(-1, 1, (len(what.channels), *shape)).astype(np.float32)
    with ExitStack() as held:
        todo = ways(name, what, maps, threads, config, held)
        best = dict.fromkeys(todo, float("inf"))
        for index in range(rounds + 1):
            for label, work in todo.items():
                begin = clock()
                work()
                if index:  # the first round warms up
                    best[label] = min(best[label], clock() - begin)
    factor = scale(name, what, shape)
    return Timed(
        name, {label: factor * best[label] for label in best}, choose_engine(threads=threads).told([name])[name]
    )


def table(found: list[Timed]) -> list[str]:
    """Markdown: seconds by way, in brackets how many times as fast as PyTorch."""
    labels = list(found[0].seconds)
    total = Timed("all", {label: sum(one.seconds[label] for one in found) for label in labels}, "")
    lines = [f"| network | {' | '.join(labels)} | auto |", "|---" * (len(labels) + 2) + "|"]
    for one in (*found, total):
        cells = [f"{one.seconds[label]:.2f} ({one.seconds[EAGER] / one.seconds[label]:.2f})" for label in labels]
        lines.append(f"| {one.name} | {' | '.join(cells)} | {one.chosen} |")
    auto = sum(one.seconds[one.chosen] for one in found)
    lines += ["", f"auto: {auto:.2f} s, {total.seconds[EAGER] / auto:.2f} times as fast as PyTorch eager"]
    for one in found:
        rivals = {label: seconds for label, seconds in one.seconds.items() if label != EAGER}
        fastest = min(rivals, key=rivals.__getitem__)
        if rivals[one.chosen] > SLOWER * rivals[fastest]:
            lines.append(f"{one.name}: auto chose {one.chosen}, but {fastest} was faster")
    return lines


def main(
    threads: Annotated[int, typer.Option(help="Compute threads; 0 for as many as this process may use.")] = 0,
    rounds: Annotated[int, typer.Option(help="The fastest of so many counts.")] = 5,
    side: Annotated[int, typer.Option(help="Pixels of the square that networks for tiles run on.")] = 512,
    processor: Annotated[
        bool, typer.Option(help="Seconds of the processor, for a busy machine and one thread.")
    ] = False,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
    config: Annotated[str, typer.Option(help="Size for PyTorch, where the table of models does not say.")] = "",
) -> None:
    """Print the table."""
    count = choose_engine(threads=threads).threads
    torch.set_num_threads(count)
    clock = time.process_time if processor else time.perf_counter
    found = []
    for name in ReflectancePlan.of(ROLES).networks:
        found.append(measure(name, count, rounds, side, config, clock))
        typer.echo(
            f"{name}: " + ", ".join(f"{key} {value:.2f} s" for key, value in found[-1].seconds.items()), err=True
        )
    tell("\n".join([f"{count} threads.", "", *table(found)]), MARK, write)


if __name__ == "__main__":
    typer.run(main)
