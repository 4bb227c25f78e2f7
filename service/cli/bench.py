"""``avatarme bench``: accuracy against time on this machine."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from service.bench.report import as_markdown, draw, put, require_matplotlib
from service.bench.runs import run_bench, runs
from service.cli.files import progress_bar
from service.errors import OutputFault, UsageError

NAME = "accuracy-time"


def bench(*, quick: bool, as_json: bool, output: str | None) -> None:
    """Measure, then print a table or JSON, or write Markdown and plot into a folder and print the path.

    Args:
        quick: fewer runs, smaller maps.
        as_json: print JSON.
        output: folder for ``accuracy-time.md`` and ``.png``; the text around the marks of an existing file is kept.

    Raises:
        UsageError: there is no such folder, or the plot cannot be drawn.
        OutputFault: the files cannot be written.
        AvatarError: the reference cannot be made.
    """
    target = None if output is None else Path(output)
    if target is not None:
        require_matplotlib()
        if not target.is_dir():
            raise UsageError(f"there is no folder {target}; name one for the table and the plot", field="output")
    with progress_bar() as progress:
        found = run_bench(runs(quick=quick), progress=progress)
    if target is not None:
        path = target / f"{NAME}.md"
        try:
            text = path.read_text(encoding="utf-8") if path.exists() else "# What accuracy costs in time\n"
            path.write_text(put(text, as_markdown(found)), encoding="utf-8")
            draw(found, target / f"{NAME}.png")
        except OSError as error:
            raise OutputFault(f"{path} cannot be written ({error.strerror})") from error
    if as_json:
        typer.echo(json.dumps(found.to_json(), allow_nan=False, default=str))
    else:
        typer.echo(as_markdown(found) if target is None else f"{target / NAME}.md\n", nl=False)
