"""Letting go of a job, of all that was made of it, of what the database knows of both, and of files without a job."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import time
from pathlib import Path

import sqlalchemy as sa

from service.jobs import telemetry
from service.jobs.artifacts import Artifacts
from service.jobs.database import EVENTS, IS_DERIVED, JOBS, now
from service.jobs.settings import Settings
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


STRAY = 3600.0
"""Age in seconds of an upload that nobody finished."""

SEEN = 300.0
"""Seconds between the first look at something that nobody knows and its end.

A clock that is set by a day makes an upload under way look old; none takes that long (``Settings.body_seconds``).
"""


ASKED = 500
"""Jobs that are looked up at a time."""


class Strays:
    """Looks for such files, and removes those that were there for long.

    Args:
        settings: of the worker.
        jobs: those that there are.
        artifacts: their files.
    """

    def __init__(self, settings: Settings, jobs: Store, artifacts: Artifacts) -> None:
        self._settings, self._jobs, self._artifacts = settings, jobs, artifacts
        self._unknown: dict[str, float] = {}

    def sweep(self) -> None:
        """Remove uploads that never became a job, and files of jobs that nobody knows."""
        incoming, artifacts = self._settings.incoming, self._artifacts
        unknown: dict[str, float] = {}
        found = artifacts.jobs()
        for start in range(0, len(found), ASKED):
            some = found[start : start + ASKED]
            for job in set(some) - set(self._jobs.versions(some)):
                age = None if artifacts.folder is None else _age(artifacts.folder / job)
                if self._is_stray(job, age, unknown):
                    artifacts.sweep(job, set())
        for path in incoming.glob("*") if incoming.is_dir() else ():
            if self._is_stray(path.name, _age(path), unknown):
                path.unlink(missing_ok=True)
        self._unknown = unknown

    def _is_stray(self, name: str, age: float | None, unknown: dict[str, float]) -> bool:
        """Whether something is old by the clock on the wall, and was seen long ago by the one that does not jump.

        Args:
            name: of it; when it was first seen is noted in ``unknown``.
            age: in seconds by the clock on the wall; None where only being seen tells, as on a remote store.
            unknown: of this look.
        """
        unknown[name] = self._unknown.get(name, time.monotonic())
        patience = max(STRAY if age is None else SEEN, 2 * self._settings.body_seconds)
        return (age is None or age >= STRAY) and time.monotonic() - unknown[name] >= patience


def _age(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return 0.0
