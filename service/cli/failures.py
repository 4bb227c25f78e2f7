"""Errors on the command line: the only place that maps them to exit statuses and messages."""

from __future__ import annotations

import json
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer

from service.errors import AvatarError, as_facts

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
