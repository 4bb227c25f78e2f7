"""What the routes stand on: made once when the server starts, and handed to them by the application."""

from __future__ import annotations

import json
import re
import shutil
import threading
import time
from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Depends
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse

from service.api.decoding import DecodingMemory, budget
from service.api.keys import Keys, Tenant
from service.api.problem_responses import HttpProblem, not_found
from service.jobs.artifacts import Artifacts
from service.jobs.database import WORKERS, connect, create_tables, seconds_of_database
from service.jobs.settings import Settings
from service.jobs.store import Row, Store
from service.machine import memory_bytes, processors
from service.photo.limits import Limits

JOB_ID = re.compile(r"[0-9a-f]{32}\Z")

LOOK_S = 0.5
"""Seconds between two looks at a job for somebody who follows it, or waits for it."""


class Json(JSONResponse):
    """JSON that nobody on the way keeps, in ASCII: text that cannot be encoded leaves escaped as it came in."""

    def __init__(self, content: Any, status_code: int = 200, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(content, status_code, {"Cache-Control": "no-store", **(headers or {})})

    def render(self, content: Any) -> bytes:
        """The bytes."""
        return json.dumps(content).encode("ascii")


FRESH = 20.0
"""Seconds for which a worker's sign of life counts."""


class Context:
    """What requests are answered with: settings, database, files.

    UsageError: the file of keys is unusable. SQLAlchemyError: the database cannot be reached.
    """

    def __init__(self, settings: Settings) -> None:
        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
        shutil.rmtree(settings.incoming, ignore_errors=True)  # what another process was receiving when it died
        settings.incoming.mkdir(parents=True, mode=0o700)
        self.settings = settings
        self.limits = Limits()
        self.keys = Keys(settings.keys)
        self.engine = connect(settings.database_url, pool=16)
        create_tables(self.engine, settings)
        self.store = Store(self.engine)
        self.artifacts = Artifacts(settings.artifacts_url)
        self.listeners = 0
        self.draining = threading.Event()
        self.uploads: Counter[str] = Counter()
        at_once = max(2, processors()) + bool(self.keys)  # with keys one place is always left to the next tenant
        self.decoding = DecodingMemory(budget(memory_bytes(), settings.decode_mb), at_once, shared=bool(self.keys))
        self._workers: tuple[float, list[dict[str, object]]] = (float("-inf"), [])

    def job(self, job: str, tenant: Tenant, kind: str = "avatar", *, gone: bool = False) -> Row:
        """The row of a tenant's job; with ``gone`` also of one that has expired or was erased.

        HttpProblem: there is none, or it belongs to somebody else, which is the same to the caller; or it is gone.
        """
        row = self.store.get(job) if JOB_ID.match(job) else None
        if row is None or row["tenant"] != tenant.name or row["kind"] != kind:
            raise not_found()
        if row["gone"] is not None and not gone:
            raise HttpProblem("gone", 410, reason=row["gone"])
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
        """Free space in MiB where uploads and results go."""
        return self.artifacts.free_mb(self.settings.incoming)


async def context_of(connection: HTTPConnection) -> Context:
    """The context of the application that got a request; asynchronous, as a hop to a thread would cost more."""
    context: Context = connection.app.state.context
    return context


async def tenant_of(connection: HTTPConnection) -> Tenant:
    """Who sent a request; HttpProblem where it is nobody whom this server knows."""
    tenant = (await context_of(connection)).keys.tenant(connection.headers)
    if tenant is None:
        raise HttpProblem("unauthorized", 401, headers={"WWW-Authenticate": "Bearer"})
    return tenant


Asking = Annotated[Tenant, Depends(tenant_of)]
Here = Annotated[Context, Depends(context_of)]
