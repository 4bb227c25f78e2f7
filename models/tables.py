"""Tables in Markdown files, kept between two marks."""

from __future__ import annotations

from pathlib import Path

import typer


def tell(text: str, mark: tuple[str, str], file: Path | None) -> None:
    """Print a text, and put it between the lines of ``mark`` in a file where one is named.

    Raises:
        SystemExit: as :func:`write_between`.
    """
    typer.echo(text)
    if file is not None:
        write_between(file, mark, text)


def write_between(file: Path, mark: tuple[str, str], text: str) -> None:
    """Replace what stands between the lines of ``mark`` in a file.

    Raises:
        SystemExit: the file has no such lines; the message names them.
    """
    before, _, rest = file.read_text("utf-8").partition(mark[0])
    _, found, after = rest.partition(mark[1])
    if not found:
        raise SystemExit(f"{file} has no lines {mark[0]} and {mark[1]}")
    file.write_text(f"{before}{mark[0]}\n{text.rstrip()}\n{mark[1]}{after}", "utf-8")
