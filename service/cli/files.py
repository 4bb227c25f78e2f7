"""What the commands share: input and output paths, atomic writing, the progress bar."""

from __future__ import annotations

import json
import mimetypes
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from service.archive.container import MEDIA_TYPES, file_beside, replace_file
from service.errors import OutputFault, UsageError
from service.photo.limits import PIPE


def check_paths(output: str, inputs: Mapping[str, str], *, what: str, example: str, as_json: bool) -> None:
    """Check that inputs, paths by what they are, and output do not share a stream or a file; ``-`` is a standard
    stream.

    UsageError: two inputs from standard input; output and JSON, or a terminal, on standard output; a name of another
    kind of file than the ``example``; an input that the output would overwrite.
    """
    piped = [name for name, path in inputs.items() if path == PIPE]
    if len(piped) > 1:
        raise UsageError(f"{' and '.join(piped)} cannot both come from standard input; name a file for one of them")
    if output == PIPE and as_json:
        raise UsageError(f"--json and the {what} cannot both go to standard output; name a file with -o {example}")
    if output == PIPE and sys.stdout.isatty():
        raise UsageError(f"standard output is a terminal; name a file with -o {example}, or redirect it")
    for name, path in inputs.items():
        files = output != PIPE and path != PIPE and os.path.exists(output) and os.path.exists(path)
        if files and os.path.samefile(output, path):
            raise UsageError(f"{output} is the {name}, which would be overwritten; name another file with -o {example}")
    right, given = Path(example).suffix, Path(output).suffix.lower()
    if given != right and (given[1:] in MEDIA_TYPES or mimetypes.guess_type(f"x{given}")[0]):
        raise UsageError(f"{output} would not be what its name says: the {what} is a {right}; name it by -o {example}")


def expect_output(target: str) -> None:
    """Raise OutputFault for a path that cannot be written, before the work, which may take minutes, and not after."""
    if target != PIPE:
        with file_beside(Path(target)):
            pass


def head_file(path: str | None) -> Path | None:
    """Path of a head model file, None for the shipped one; UsageError where there is no such file."""
    if path is not None and not Path(path).is_file():
        raise UsageError(
            f"there is no head model file {path}; docs/head-model.md describes how to make one", field="head"
        )
    return None if path is None else Path(path)


def write_bytes(target: str, data: bytes) -> None:
    """Write to a path, or to standard output for ``-``; OutputFault: it fails, and an existing file is unchanged."""
    if target != PIPE:
        replace_file(Path(target), lambda stream: stream.write(data))
        return
    try:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
    except BrokenPipeError as error:
        raise OutputFault("the reader of the output closed it before it was complete") from error


def tell_result(path: str, facts: Mapping[str, Any], *, as_json: bool) -> None:
    """Say where the output lies, unless it went to standard output; or facts of the run, as one JSON object."""
    if as_json:
        typer.echo(json.dumps(facts, allow_nan=False))
    elif path != PIPE:
        typer.echo(os.fsencode(path))  # bytes, as a file name need not be valid text


if TYPE_CHECKING:
    from service.pipeline import Progress


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A progress bar if stderr is a terminal, else a function that does nothing. Colour obeys NO_COLOR."""
    if not sys.stderr.isatty():
        yield lambda stage, share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("start", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=min(max(share, 0.0), 1.0))
