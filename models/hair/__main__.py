"""A sheet of grooms: ``python -m models.hair sheet [--count 64] [-o docs/grooms.jpg]``; ``--named`` for the named."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import cv2
import typer

from models.hair.draw import sheet
from models.hair.random_styles import sample_style
from service.hair.groom import make_groom
from service.hair.style import NAMED
from service.head.files import load_head

app = typer.Typer(add_completion=False)


@app.callback()
def _commands() -> None:
    """Grooms for the documentation and for training."""


@app.command("sheet")
def draw_sheet(
    count: Annotated[int, typer.Option(min=1, help="Grooms.")] = 64,
    first: Annotated[int, typer.Option(help="Seed of the first.")] = 0,
    named: Annotated[bool, typer.Option(help="The named styles instead of random ones.")] = False,
    strands: Annotated[int, typer.Option(min=1, help="Of a full head.")] = 10_000,
    columns: Annotated[int, typer.Option(min=1)] = 4,
    size: Annotated[int, typer.Option(min=64, help="Pixels of a picture's side.")] = 200,
    output: Annotated[Path, typer.Option("-o", "--output")] = Path("build/grooms.jpg"),
) -> None:
    """Draw it."""
    styles = list(NAMED.values()) if named else [sample_style(seed) for seed in range(first, first + count)]
    grooms, begin = [], time.perf_counter()
    for seed, style in enumerate(styles, first):
        grooms.append(make_groom(style, seed, strands))
    typer.echo(f"{(time.perf_counter() - begin) / len(styles):.2f} s a groom", err=True)
    picture = sheet(grooms, load_head(), columns, size)
    output.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(output), picture[..., ::-1]):
        raise SystemExit(f"{output} cannot be written")
    typer.echo(str(output))


if __name__ == "__main__":
    app()
