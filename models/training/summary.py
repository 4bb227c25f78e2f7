"""Training runs as a table: ``python -m models.training.summary build/training --write docs/training.md``.

Reads the logs and checkpoints of runs; ``--write`` puts the table between ``<!-- runs -->`` and ``<!-- /runs -->``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import torch
import typer

from models.tables import tell
from service.errors import ModelFault

MARK = ("<!-- runs -->", "<!-- /runs -->")


def rows(folder: Path) -> list[str]:
    """One Markdown row a run: what, how long, and the held-out score on the way.

    Raises:
        ModelFault: there is no run.
    """
    found = []
    for run in sorted(folder.iterdir()):
        if not (run / "checkpoint.pt").exists() or not (run / "log.jsonl").exists():
            continue
        settings = torch.load(run / "checkpoint.pt", map_location="cpu", weights_only=True)["run"]
        lines = [json.loads(line) for line in (run / "log.jsonl").read_text(encoding="utf-8").splitlines()]
        last = lines[-1]
        way = [lines[0], lines[len(lines) // 2], last]
        scores = ", ".join(f"{line['held_out']['score']:.4g} at {line['step']}" for line in way)
        others = ", ".join(f"{name} {value:.3g}" for name, value in last["held_out"].items() if name != "score")
        adversarial = "yes" if settings["adversarial_weight"] > 0 else "no"
        size = f"{last['step']} x {settings['batch']} of {settings['side']}^2"
        cells = (settings["network"], settings["config"], size, f"{settings['rate']:g}", adversarial)
        found.append("| " + " | ".join([*cells, f"{last['seconds'] / 3600:.2f}", scores, others]) + " |")
    if not found:
        raise ModelFault(f"{folder} has no training runs; make one with: python -m models.training.train")
    return found


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of the runs.")],
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    head = "| network | config | steps x batch | rate | discriminator | hours | held-out score | other numbers |"
    table = "\n".join([head, "|---" * 8 + "|", *rows(folder)]) + "\n"
    tell(table, MARK, write)


if __name__ == "__main__":
    typer.run(main)
