"""What the routes stand on: made once when the server starts, and handed to them by the application."""

from __future__ import annotations

import shutil
import threading
import time

import sqlalchemy as sa
from starlette.requests import HTTPConnection

from service.api.decoding import DecodingMemory, budget
from service.api.glance import Glance
from service.api.keys import Keys, Tenant
from service.api.problems import ProblemError, not_found
from service.api.watcher import Watcher
from service.jobs.artifacts import Artifacts
from service.jobs.database import WORKERS, connect, create_tables, seconds_of_database
from service.jobs.machine import memory_bytes, processors
from service.jobs.queue import Queue
from service.jobs.settings import Settings
from service.jobs.store import Row, Store
from service.photo.limits import Limits

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
        self.queue = Queue(self.engine)
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
