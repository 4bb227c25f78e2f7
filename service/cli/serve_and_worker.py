"""``avatarme serve`` and ``avatarme worker``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from service.errors import UsageError
from service.jobs.settings import Settings, from_environment


def serve(flags: dict[str, Any], *, with_worker: bool) -> None:
    """Serve until a signal ends it.

    Args:
        flags: settings from the command line, None where not given.
        with_worker: run a worker beside the server.

    Raises:
        UsageError: a setting is not possible, or another server has the data folder.
    """
    settings = _settings(flags)
    from service.api.server import serve as run

    run(settings, with_worker=with_worker)


def work(flags: dict[str, Any]) -> None:
    """Run a worker until a signal ends it.

    Raises:
        UsageError: a setting is not possible.
    """
    settings = _settings(flags)
    if not settings.database:
        raise UsageError(
            "a worker by itself needs the Postgres of the server: --database postgresql://...", field="database"
        )
    from service.api.server import work as run

    module = "service.batch.worker" if settings.batches else "service.jobs.worker"
    raise typer.Exit(run(settings, module))


def _settings(flags: dict[str, Any]) -> Settings:
    return from_environment({**flags, "data": None if flags.get("data") is None else Path(flags["data"])})
