"""Letting go of a job, of all that was made of it, and of what the database knows of both."""

from __future__ import annotations

import contextlib
import json
import sqlite3

import sqlalchemy as sa

from service.jobs import telemetry
from service.jobs.database import EVENTS, IS_DERIVED, JOBS, now
from service.jobs.store import OWNERS, Row, Store, workflows
from service.jobs.view import FINAL

MEASURED = ("quality", "size", "maps")
"""Options that say what the time of a job was needed for."""

_FOLD_S = 0.25
"""Longest time in seconds that emptying the write-ahead log waits for readers."""


def let_go(store: Store, row: Row, reason: str, expires: float | None = None) -> list[str]:
    """Cancel a job that is unfinished, forget the result of one that has ended; the same for what was made of it.

    Files are removed by whoever sweeps afterwards.

    Args:
        store: the jobs.
        row: of the job.
        reason: "erased" or "expired".
        expires: until when a cancelled job says that it was; None for now.

    Returns:
        Ids of the jobs whose files may go.
    """
    derived = store.where(IS_DERIVED, JOBS.c.source == row["id"], JOBS.c.gone.is_(None))
    for one in (*derived, row):
        if store.cancel(one["id"], now() if expires is None else expires):
            store.queue.cancel(one["workflow"])
        elif one["gone"] is None:
            depart(store.engine, one["id"], reason)
            store.queue.delete(workflows(one))  # results of steps name files by their hashes
    return [one["id"] for one in (*derived, row)]


def depart(engine: sa.Engine, job: str, reason: str) -> None:
    """Results are no longer given out; ``reason`` is "expired" or "erased".

    What stays are the times, what they belong to, and what a quota counts; hashes, key and names go.
    """
    with engine.begin() as connection:
        where = (JOBS.c.id == job, JOBS.c.gone.is_(None), JOBS.c.state.in_(FINAL))
        row = connection.execute(sa.select(JOBS.c.options, JOBS.c.state, JOBS.c.tenant).where(*where)).one_or_none()
        if row is None:
            return
        kept = {name: value for name, value in json.loads(row.options).items() if name in MEASURED}
        values = {"gone": reason, "swept": False, "error": None, "warnings": "[]", "options": json.dumps(kept)}
        values |= {**OWNERS, "archive": None, "archive_sha256": None, "archive_bytes": None, "webhook": None}
        if not connection.execute(sa.update(JOBS).where(*where).values(updated_at=now(), **values)).rowcount:
            return
        connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job))
        telemetry.count_change(connection, row.tenant, row.state, None)


def forget(engine: sa.Engine, job: str) -> None:
    """Remove the row and the events."""
    with engine.begin() as connection:
        connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job))
        connection.execute(sa.delete(JOBS).where(JOBS.c.id == job))


def checkpoint(engine: sa.Engine) -> bool:
    """Fold SQLite's write-ahead log into the database and empty it: what was overwritten is nowhere any more.

    Returns:
        Whether the log is empty; not so while somebody reads.
    """
    if engine.dialect.name != "sqlite":
        return True
    made = sqlite3.connect(str(engine.url.database), timeout=_FOLD_S)
    with contextlib.closing(made) as connection, contextlib.suppress(sqlite3.Error):
        return not connection.execute("pragma wal_checkpoint(truncate)").fetchone()[0]
    return False
