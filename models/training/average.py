"""Mean of the weights of runs that began alike: ``python -m models.training.average RUN RUN -o RUN --data DIR``.

Between the weights before and after training on something new there are often ones that have learnt it and forgotten
less (Wortsman et al. 2022, model soups). The new run can be converted and gone on with like any other.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import torch
import typer
from torch import Tensor

from models.training.train import TASKS, write_sheet
from models.training.trainer import Run, Trainer
from service.errors import ModelFault, UsageError

Weights = dict[str, Tensor]


def mean_of(parts: list[Weights]) -> Weights:
    """Mean of floating-point weights; others as in the first.

    Raises:
        ModelFault: names or shapes differ.
    """
    first = parts[0]
    for other in parts[1:]:
        unlike = sorted(
            k for k in {*first, *other} if k not in first or k not in other or first[k].shape != other[k].shape
        )
        if unlike:
            raise ModelFault(f"the runs are of different networks: {unlike[0]} and {len(unlike) - 1} more differ")
    return {
        name: torch.stack([part[name] for part in parts]).mean(0) if value.is_floating_point() else value
        for name, value in first.items()
    }


def main(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs of the same network and configuration.")],
    output: Annotated[Path, typer.Option("-o", help="Folder of the new run.")],
    data: Annotated[Path, typer.Option(help="Folder of captures, to measure it on.")],
) -> None:
    """Write a run whose averaged weights are the mean of those of others; settings and log are the first one's."""
    if len(runs) < 2:
        raise UsageError(f"{len(runs)} run was given; a mean takes two or more")
    contents = [torch.load(run / "checkpoint.pt", map_location="cpu", weights_only=True) for run in runs]
    run = Run(**contents[0]["run"])
    for other, folder in zip(contents[1:], runs[1:], strict=True):
        if other["run"]["network"] != run.network:
            raise UsageError(f"{folder} is a run of {other['run']['network']}, {runs[0]} of {run.network}")
    trainer = Trainer(run, TASKS[run.network](data, run.side), "cpu")
    trainer.task.refresh()
    trainer.load(runs[0])
    trainer.take(mean_of([content["average"] for content in contents]))
    numbers, sheet = trainer.measure()
    output.mkdir(parents=True, exist_ok=True)
    trainer.save(output)
    write_sheet(sheet, output / "sheet.png")
    line = {"step": trainer.step, "seconds": round(trainer.seconds), "held_out": numbers, "mean_of": len(runs)}
    log = (runs[0] / "log.jsonl").read_text("utf-8") if (runs[0] / "log.jsonl").exists() else ""
    (output / "log.jsonl").write_text(log + json.dumps(line) + "\n", encoding="utf-8")
    typer.echo(json.dumps(line))


if __name__ == "__main__":
    typer.run(main)
