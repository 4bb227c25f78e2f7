"""Command line of the light stage: ``python -m models.lightstage sample | sheet | list``."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from service.errors import AvatarError, UsageError

app = typer.Typer(add_completion=False, no_args_is_help=True, help="A synthetic light stage: people with known skin.")


def _pair(text: str, separator: str, what: str) -> tuple[int, int]:
    match = re.fullmatch(rf"(\d+){separator}(\d+)", text.strip())
    if match is None:
        raise UsageError(f"{what} {text!r} is not of the form A{separator}B with whole numbers")
    return int(match[1]), int(match[2])


@app.command()
def sample(
    seed: Annotated[int, typer.Option(min=0, help="Names the person.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write to.")],
    size: Annotated[str, typer.Option(help="Size of the maps, 3:2.")] = "6144x4096",
    expression: Annotated[str, typer.Option(help="neutral, smile, frown, surprise ...")] = "neutral",
) -> None:
    """Write all maps of one person in one expression."""
    from models.lightstage.sample import write_sample
    from models.lightstage.stage import Stage

    width, height = _pair(size, "x", "--size")
    try:
        names = write_sample(Stage.open(), seed, width, height, expression, out)
    except KeyError as error:
        raise UsageError(str(error.args[0])) from error
    typer.echo("\n".join(str(out / name) for name in names))
    if "texture.png" not in names:
        typer.echo("no texture.png: models.lightstage.light, which bakes the light, is not installed", err=True)


@app.command()
def sheet(
    seeds: Annotated[str, typer.Option(help="A:B, the people A to B - 1.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="PNG to write.")],
    size: Annotated[int, typer.Option(min=64, max=1024, help="Side of the pieces at 1:1, pixels.")] = 256,
) -> None:
    """Draw many people at a glance, whole and at 1:1."""
    from models.lightstage.sheet import sheet as draw
    from models.lightstage.stage import Stage
    from service.archive.images import encode_png

    first, end = _pair(seeds, ":", "--seeds")
    if end <= first:
        raise UsageError(f"--seeds {seeds}: the second number must be larger than the first")
    out.write_bytes(encode_png(draw(Stage.open(), range(first, end), size), srgb=True))
    typer.echo(str(out))


@app.command("list")
def list_captures() -> None:
    """Print all captures (seed, expression, part), tab-separated."""
    from models.lightstage.split import captures

    for capture in captures():
        typer.echo(f"{capture.seed}\t{capture.expression}\t{capture.part}")


def main() -> int:
    """Run; faults of ours become one line on stderr and an exit status."""
    try:
        app(standalone_mode=False)
    except AvatarError as error:
        typer.echo(f"error: {error.message}", err=True)
        return error.exit_status
    except typer.Exit as done:
        return done.exit_code
    except Exception as error:  # usage errors of typer's own parser
        shown = getattr(error, "format_message", None)
        if shown is None:
            raise
        typer.echo(f"error: {shown()}", err=True)
        return UsageError.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
