"""The command ``avatarme``: which commands there are, and how their errors become exit statuses and messages.

The module of each command is imported when it runs.
"""

from __future__ import annotations

import ast
import functools
import json
import logging
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from service import __version__
from service.errors import AvatarError, as_facts

COMMANDS = {
    "make": "make_and_maps", "batch": "batch", "maps": "make_and_maps", "render": "render_and_export",
    "export": "render_and_export", "serve": "serve_and_worker", "worker": "serve_and_worker",
    "bench": "bench_and_doctor", "doctor": "bench_and_doctor",
}  # fmt: skip
"""The module of each command, in which a function of its name is the command."""

PLAIN: dict[str, Any] = {
    "add_completion": False,
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,  # square brackets in help are literal, and rich need not be imported
}


INTERRUPTED = 130
"""128 + SIGINT: the exit status that shells expect after Ctrl-C."""


def exit_status(error: BaseException) -> int:
    """Exit status of an error: that of its class in ``service.errors``, 130 for Ctrl-C, 1 for anything else."""
    if isinstance(error, AvatarError):
        return error.exit_status
    return INTERRUPTED if isinstance(error, KeyboardInterrupt) else 1


def describe(error: BaseException) -> dict[str, Any]:
    """``{"error": {"code", "message", ...}}`` with the error's machine-readable facts."""
    if isinstance(error, KeyboardInterrupt):
        return {"error": {"code": "interrupted", "message": "interrupted"}}
    facts = as_facts(error)
    del facts["status"]  # of HTTP
    return {"error": facts}


@contextmanager
def reported(*, as_json: bool) -> Iterator[None]:
    """Turn any exception of the body into a message on stderr, JSON on stdout if requested, and ``typer.Exit``.

    An exception that is not an :class:`AvatarError` is a bug, so its traceback goes to stderr for the bug report.
    """
    try:
        yield
    except typer.Exit:
        raise
    except (Exception, KeyboardInterrupt) as error:
        description = describe(error)
        if not isinstance(error, AvatarError | KeyboardInterrupt):
            typer.echo("".join(traceback.format_exception(error)), err=True, nl=False)
        typer.echo(f"avatarme: {description['error']['message']}", err=True)
        if as_json:
            typer.echo(json.dumps(description, default=str))
        raise typer.Exit(exit_status(error)) from error


class Commands(TyperGroup):
    """The commands, each made from its function when it is asked for; the list of them imports none."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """One command, whose faults are reported; None where there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        command = getattr(import_module(f"service.cli.{COMMANDS[cmd_name]}"), cmd_name)

        @functools.wraps(command)
        def run(**given: Any) -> None:
            with reported(as_json=given.get("as_json", False)):
                command(**given)

        alone = typer.Typer(**PLAIN)
        alone.command(cmd_name)(run)
        return typer.main.get_command(alone)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the names and the first sentence of each function's docstring."""
        limit = formatter.width - 6 - max(map(len, COMMANDS))
        with formatter.section("Commands"):
            plain = {name: TyperCommand(name, help=_docstring(name)) for name in COMMANDS}
            formatter.write_dl([(name, one.get_short_help_str(limit)) for name, one in plain.items()])


def _docstring(name: str) -> str:
    """Docstring of a command, from its module's source."""
    source = ast.parse((Path(__file__).parent / f"{COMMANDS[name]}.py").read_text("utf-8"))
    found = next(one for one in source.body if isinstance(one, ast.FunctionDef) and one.name == name)
    return ast.get_docstring(found) or ""


app = typer.Typer(
    name="avatarme", cls=Commands, help="Photos of one face in, a renderable head out.", no_args_is_help=True, **PLAIN
)


def run() -> None:
    """Entry point of the console script: :func:`main`, with an end at once where all went well.

    What the libraries hold takes a tenth of a second to be torn down.
    """
    try:
        main()
    except SystemExit as ended:
        if ended.code:
            raise
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def main() -> None:
    """The command; always ends in SystemExit with the status of :func:`exit_status`."""
    # OpenBLAS reads this when numpy loads. The fit's matrices are too small to gain from threads, and OpenBLAS waits
    # for its threads by spinning: a fit of 0.13 s took 9 s while another process used the second core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app(prog_name="avatarme")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"avatarme {__version__}")
        raise typer.Exit


@app.callback()
def avatarme(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """One photo of a face in, a renderable head out."""
