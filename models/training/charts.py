"""A sheet of charts as the context's training sees them: ``python -m models.training.charts --data DIR -o FILE``.

Each is the texture, all but lit skin darkened, above its albedo: what painted hair, hard light, darker skin, other
cameras and covers make of a few captures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer
from torch import Tensor
from torch.nn import functional

from models.training.context import ContextTask
from models.training.tasks import Batch
from models.training.train import write_sheet
from service.errors import UsageError

UNSEEN = 0.35
"""Share of its coded value that is left of a texel that the network is not shown."""


def pairs(batch: Batch) -> Tensor:
    """(N, 3, h, w) sRGB-coded in [0, 1]: texture above albedo, at half their size."""
    lit = batch["lit"]
    shown = batch["texture"] * (UNSEEN + (1.0 - UNSEEN) * lit)
    both = torch.cat([shown, batch["albedo"]], 2)
    return functional.avg_pool2d(both, 2)


def main(
    data: Annotated[Path, typer.Option(help="Folder of captures.")],
    output: Annotated[Path, typer.Option("-o", help="PNG or JPEG to write.")],
    count: Annotated[int, typer.Option(min=1, help="Charts.")] = 64,
    columns: Annotated[int, typer.Option(min=1)] = 8,
    seed: int = 1,
) -> None:
    """Write the sheet.

    Raises:
        UsageError: the charts do not fill their rows.
    """
    if count % columns:
        raise UsageError(f"{count} charts do not fill rows of {columns}; give a multiple of it")
    task = ContextTask(data)
    task.train.refresh()
    charts = pairs(task.batch(count, torch.Generator().manual_seed(seed)))
    rows = [torch.cat(list(charts[i : i + columns]), 2) for i in range(0, count, columns)]
    write_sheet(torch.cat(rows, 1), output)
    typer.echo(f"{output}: {count} charts")


if __name__ == "__main__":
    typer.run(main)
