"""``avatarme serve`` and ``avatarme worker``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from service.cli.flags import SERVER, Flag, with_flags
from service.errors import UsageError
from service.jobs.settings import from_environment


@with_flags(
    {
        "host": Flag("Address to listen on. [default: 127.0.0.1]"),
        "port": Flag("Port to listen on. [default: 8000]", int),
        **SERVER,
        "keys": Flag("File of API keys. [default: none needed]", str, "FILE"),
    }
)
def serve(
    anybody: Annotated[
        bool | None, typer.Option("--anybody", help="Serve others than this machine without keys.")
    ] = None,
    worker: Annotated[bool, typer.Option(help="Run a worker beside the server.")] = True,
    **flags: Any,
) -> None:
    """Take photos over HTTP.

    Every setting can also come from the environment: AVATARME_PORT, AVATARME_RESULT_HOURS ...; docs/service.md has all.
    """
    settings = from_environment(flags | {"anybody": anybody})
    from service.api.server import serve as run

    run(settings, with_worker=worker)


@with_flags(SERVER | {"batches": Flag("Photos of batches computed beside them. [default: 0]", int)})
def worker(
    name: Annotated[str | None, typer.Option(help="Name of this worker, unlike all others and lasting.")] = None,
    **flags: Any,
) -> None:
    """Compute jobs that a server elsewhere takes, and shards of batches."""
    settings = from_environment(flags | {"worker": name})
    if not settings.database:
        raise UsageError(
            "a worker by itself needs the Postgres of the server: --database postgresql://...", field="database"
        )
    from service.api.server import work as run

    raise typer.Exit(run(settings, "service.batch.worker" if settings.batches else "service.jobs.worker"))
