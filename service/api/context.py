"""What the routes stand on: made once when the server starts, and handed to them by the application."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import sqlalchemy as sa
from fastapi import Depends
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from service.api.decoding import DecodingMemory, budget
from service.api.keys import Keys, Tenant
from service.api.problem_responses import ProblemError, not_found
from service.jobs.artifacts import Artifacts
from service.jobs.database import WORKERS, connect, create_tables, seconds_of_database
from service.jobs.machine import memory_bytes, processors
from service.jobs.settings import Settings
from service.jobs.store import Row, Store
from service.jobs.view import FINAL
from service.photo.limits import Limits

INTERVAL = 0.25
_CHUNK = 500

log = logging.getLogger(__name__)


class Watcher:
    """Wakes listeners; jobs nobody listens to are not looked at."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._listeners: dict[str, set[asyncio.Event]] = {}
        self._known: dict[str, int] = {}
        self._task: asyncio.Task[None] | None = None

    @contextlib.contextmanager
    def listening(self, job: str) -> Iterator[asyncio.Event]:
        """An event that is set whenever the job has new events."""
        event = asyncio.Event()
        self._listeners.setdefault(job, set()).add(event)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._watch())
        try:
            yield event
        finally:
            self._listeners[job].discard(event)
            if not self._listeners[job]:
                del self._listeners[job]
                self._known.pop(job, None)

    def wake_all(self) -> None:
        """Wake every listener, for the end of the server."""
        for events in self._listeners.values():
            for event in events:
                event.set()

    @property
    def count(self) -> int:
        """Number of listeners."""
        return sum(len(events) for events in self._listeners.values())

    async def _watch(self) -> None:
        while self._listeners:
            jobs = list(self._listeners)
            for start in range(0, len(jobs), _CHUNK):
                try:
                    versions = await run_in_threadpool(self._store.versions, jobs[start : start + _CHUNK])
                except sa.exc.SQLAlchemyError as error:
                    log.warning("events cannot be read: %s", error)
                    break
                for job in jobs[start : start + _CHUNK]:
                    version = versions.get(job, -1)  # -1: the row is gone
                    if self._known.get(job) != version:
                        self._known[job] = version
                        for event in self._listeners.get(job, ()):
                            event.set()
            await asyncio.sleep(INTERVAL)


_STATE_QUERY = (
    "select j.tenant, j.state, j.gone, e.body from avatarme_jobs j "
    "join avatarme_events e on e.job = j.id and e.n = j.events where j.id = ? and j.kind = 'avatar'"
)

_BUSY_S = 0.02
"""Longest time in seconds that a look-up may hold up all other requests."""


class Glance:
    """Looks at jobs without a thread: a connection of its own for reading, to a SQLite file on this machine.

    A database that is reached over a network may take its time, which would hold up all other requests; it is never
    asked in this way.

    Args:
        path: of the SQLite file, "" for another kind of database.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._connection: sqlite3.Connection | None = None

    def state(self, job: str, tenant: str) -> tuple[bytes, bool] | None:
        """JSON of a job and whether it has ended; None where the long way has to answer.

        Args:
            job: 32 hex digits.
            tenant: who asks.
        """
        if not self._path:
            return None
        try:
            if self._connection is None:
                self._connection = sqlite3.connect(
                    f"{Path(self._path).resolve().as_uri()}?mode=ro", timeout=_BUSY_S, uri=True, isolation_level=None,
                    check_same_thread=False,
                )  # fmt: skip
            rows = self._connection.execute(_STATE_QUERY, (job,)).fetchall()
        except sqlite3.Error:
            self.close()
            return None
        if not rows or rows[0][0] != tenant or rows[0][2] is not None:
            return None
        return rows[0][3].encode(), rows[0][1] in FINAL

    def close(self) -> None:
        """Let go of the file; it is opened again when it is needed."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(sqlite3.Error):
                connection.close()


FRESH = 20.0
"""Seconds for which a worker's sign of life counts."""


class Context:
    """Everything a request may need.

    Args:
        settings: of the server.

    Raises:
        UsageError: the file of keys is unusable.
        sqlalchemy.exc.SQLAlchemyError: the database cannot be reached.
    """

    def __init__(self, settings: Settings) -> None:
        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        settings.incoming.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.settings = settings
        self.limits = Limits()
        self.keys = Keys(settings.keys)
        self.engine = connect(settings.database_url, pool=16)
        create_tables(self.engine, settings)
        self.store = Store(self.engine)
        self.glance = Glance(self.engine.url.database or "" if self.engine.dialect.name == "sqlite" else "")
        self.artifacts = Artifacts(settings.artifacts_url)
        self.watcher = Watcher(self.store)
        self.draining = threading.Event()
        self.uploads = 0
        self.decoding = DecodingMemory(budget(memory_bytes(), settings.decode_mb), max(2, processors()))
        self._workers: tuple[float, list[dict[str, object]]] = (float("-inf"), [])

    def job(self, job: str, tenant: Tenant, kind: str = "avatar") -> Row:
        """The row of a tenant's job.

        Raises:
            ProblemError: there is none, or it belongs to somebody else, which is the same to the caller; or it is gone.
        """
        row = self.store.get(job) if len(job) == 32 else None
        if row is None or row["tenant"] != tenant.name or row["kind"] != kind:
            raise not_found()
        if row["gone"] is not None:
            raise ProblemError("gone", 410, reason=row["gone"])
        return row

    def workers(self) -> list[dict[str, object]]:
        """Workers that gave a sign of life lately: ``name``, ``ready``, ``fault``; looked up at most once a second."""
        moment, known = self._workers
        if time.monotonic() - moment > 1.0:
            columns = (WORKERS.c.name, WORKERS.c.ready, WORKERS.c.fault)
            query = sa.select(*columns).where(WORKERS.c.seen_at > seconds_of_database(self.engine) - FRESH)
            with self.engine.connect() as connection:
                known = [dict(row) for row in connection.execute(query).mappings()]
            self._workers = (time.monotonic(), known)
        return known

    def free_mb(self) -> float:
        """Free space where uploads and results go."""
        folder = self.artifacts.folder or self.settings.data
        return min(shutil.disk_usage(path).free for path in (folder, self.settings.incoming)) / 2**20

    def check_space(self) -> None:
        """Refuse uploads that would use up the reserve.

        Raises:
            ProblemError: there is too little space.
        """
        if self.free_mb() < self.settings.reserve_mb:
            raise ProblemError("no-space", 507, headers={"Retry-After": "120"})

    def close(self) -> None:
        """Let go of the database."""
        self.glance.close()
        self.engine.dispose()


async def context_of(connection: HTTPConnection) -> Context:
    """The context of the application that got a request; asynchronous, as a hop to a thread would cost more."""
    context: Context = connection.app.state.context
    return context


async def tenant_of(connection: HTTPConnection) -> Tenant:
    """Who sent a request.

    Raises:
        ProblemError: nobody whom this server knows.
    """
    tenant = (await context_of(connection)).keys.tenant(connection.headers)
    if tenant is None:
        raise ProblemError("unauthorized", 401, headers={"WWW-Authenticate": "Bearer"})
    return tenant


Asking = Annotated[Tenant, Depends(tenant_of)]
Here = Annotated[Context, Depends(context_of)]
