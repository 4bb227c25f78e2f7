"""What the routes stand on: made once when the server starts, and handed to them by the application."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import re
import shutil
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Depends
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.responses import JSONResponse

from service.api.keys import Keys, Tenant
from service.api.problem_responses import HttpProblem, not_found
from service.jobs.artifacts import Artifacts
from service.jobs.database import WORKERS, connect, create_tables, seconds_of_database
from service.jobs.settings import Settings
from service.jobs.store import Row, Store
from service.machine import memory_bytes, processors
from service.photo.container import open_container
from service.photo.limits import Limits
from service.photo.wire import Codec

MIB = 1 << 20

FIXED = 64 * MIB
"""Bytes of a decoding process without an image; 37 MiB were measured."""

RESERVE = 512 * MIB
"""Bytes that are left to the server itself, its uploads, its listeners and the page cache of its files."""

MOST = 2600 * MIB
"""Largest budget: two of the largest photos at a time."""

PER_PIXEL = {"webp": 18, "jpeg": 9, "png": 9, "png-alpha": 14, "png-16": 20, "other": 20}
"""Bytes that decoding takes for each pixel, by what the file says of itself.

Measured as the most memory of the decoding process over pixels, images of 4000 and 8000 a side: WebP 17.5; JPEG 5.2,
progressive 7.8; PNG of 8 bits 4.6 to 5.2, with alpha 12.3, of 16 bits 8.3 (grey) to 17.6 (RGB) and 1.2 GB for 8000 x
8000 RGBA. ``tests/service/api/test_decoding.py`` holds them against decoders.
"""


@dataclass(eq=False)
class _Share:
    """Memory that a photo wants, or has."""

    tenant: str
    cost: int
    turn: asyncio.Future[None]


class DecodingMemory:
    """A budget of memory that photos share, in turns of their tenants: whoever has least decoded now comes first.

    What a decoder needs is known from the first bytes: the format and the size. So photos that fit together are looked
    through together, large ones wait for each other, and one that could never fit is refused with that reason, instead
    of ending as a process that the system kills.

    Args:
        total: bytes.
        most: photos at a time.
        shared: between tenants. Then what one of them takes beyond its first photo leaves half of the bytes and one
            place to the others, so that nobody waits behind the large photos of somebody else.
    """

    def __init__(self, total: int, most: int, *, shared: bool = False) -> None:
        self.total = total
        self._most = most
        self._shared = shared
        self._held: list[_Share] = []
        self._waiting: list[_Share] = []

    @contextlib.asynccontextmanager
    async def taken(self, cost: int, tenant: str = "") -> AsyncIterator[None]:
        """Hold ``cost`` bytes, as soon as they are free.

        Raises:
            HttpProblem: there never are so many.
        """
        if cost > self.total:
            words = f"decoding this photo takes {cost // MIB} MiB of memory, and this server has {self.total // MIB}"
            raise HttpProblem(
                "needs-memory", 413, f"{words} for it; send one with fewer pixels, or of 8 bits without transparency",
                needed_mib=cost // MIB, limit_mib=self.total // MIB,
            )  # fmt: skip
        share = _Share(tenant, cost, asyncio.get_running_loop().create_future())
        self._waiting.append(share)
        self._next()
        try:
            await share.turn
            yield
        finally:
            (self._held if share in self._held else self._waiting).remove(share)
            self._next()

    def _next(self) -> None:
        """Let those in whose turn it is; a tenant that may have no more now holds up nobody else."""
        while True:
            able = [share for share in self._waiting if self._may(share)]
            first = min(able, key=lambda share: len(self._of(share.tenant)), default=None)
            bytes_held = sum(share.cost for share in self._held)
            if first is None or len(self._held) >= self._most or bytes_held + first.cost > self.total:
                return
            self._waiting.remove(first)
            self._held.append(first)
            if not first.turn.done():
                first.turn.set_result(None)

    def _may(self, share: _Share) -> bool:
        own = self._of(share.tenant)
        if not self._shared or not own:
            return True
        return len(own) < self._most - 1 and sum(other.cost for other in own) + share.cost <= self.total // 2

    def _of(self, tenant: str) -> list[_Share]:
        return [share for share in self._held if share.tenant == tenant]


def budget(memory: int, stated_mb: int) -> int:
    """Bytes for decoding on a machine or in a container with so many.

    Args:
        memory: bytes of all.
        stated_mb: setting ``decode_mb``; 0 for what is left beside the server.
    """
    return stated_mb * MIB if stated_mb else max(min(memory - RESERVE, MOST), 2 * FIXED)


def cost(data: bytes, limits: Limits) -> int:
    """Bytes that the process takes that decodes a photo.

    Raises:
        UnreadableInput: one of its subclasses, for what can be seen without decoding.
    """
    if not data:
        return FIXED  # the gate has words for it
    container = open_container(data, limits)
    if container.size is None:
        return FIXED + limits.max_pixels * PER_PIXEL["other"]
    width, height = container.size
    return FIXED + width * height * PER_PIXEL[_kind(container.codec, data)]


def _kind(codec: int, data: bytes) -> str:
    if codec == Codec.JPEG:
        return "jpeg"
    if codec == Codec.PNG:
        depth, colour = data[24], data[25]  # of IHDR, which has to come first
        return "png-16" if depth == 16 else "png-alpha" if colour in (3, 4, 6) else "png"
    return "webp" if codec == Codec.WEBP else "other"


JOB_ID = re.compile(r"[0-9a-f]{32}\Z")

INTERVAL = 0.25
"""Seconds between two looks at the database for new events."""

_CHUNK = 500

log = logging.getLogger(__name__)


class Json(JSONResponse):
    """JSON that nobody on the way keeps, in ASCII: text that cannot be encoded leaves escaped as it came in."""

    def __init__(self, content: Any, status_code: int = 200, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(content, status_code, {"Cache-Control": "no-store", **(headers or {})})

    def render(self, content: Any) -> bytes:
        """The bytes."""
        return json.dumps(content).encode("ascii")


class Watcher:
    """Wakes listeners when their job has new events, or when the keys have changed.

    Args:
        store: where jobs are looked up; those that nobody listens to are not.
        keys: looked at as often.
    """

    def __init__(self, store: Store, keys: Keys) -> None:
        self._store = store
        self._keys = keys
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
        """Wake every listener."""
        for events in self._listeners.values():
            for event in events:
                event.set()

    @property
    def count(self) -> int:
        """Number of listeners."""
        return sum(len(events) for events in self._listeners.values())

    async def _watch(self) -> None:
        edition = self._keys.edition()
        while self._listeners:
            if edition != (edition := self._keys.edition()):
                self.wake_all()
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


FRESH = 20.0
"""Seconds for which a worker's sign of life counts."""


class Context:
    """What requests are answered with: settings, database, files.

    Args:
        settings: of the server.

    Raises:
        UsageError: the file of keys is unusable.
        sqlalchemy.exc.SQLAlchemyError: the database cannot be reached.
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
        self.watcher = Watcher(self.store, self.keys)
        self.draining = threading.Event()
        self.uploads: Counter[str] = Counter()
        at_once = max(2, processors()) + bool(self.keys)  # with keys one place is always left to the next tenant
        self.decoding = DecodingMemory(budget(memory_bytes(), settings.decode_mb), at_once, shared=bool(self.keys))
        self._workers: tuple[float, list[dict[str, object]]] = (float("-inf"), [])

    def job(self, job: str, tenant: Tenant, kind: str = "avatar", *, gone: bool = False) -> Row:
        """The row of a tenant's job.

        Args:
            job: its id, as a stranger says it.
            tenant: who asks.
            kind: of the job.
            gone: also one that has expired or was erased.

        Raises:
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
        """Free space where uploads and results go."""
        folder = self.artifacts.folder or self.settings.data
        return min(shutil.disk_usage(path).free for path in (folder, self.settings.incoming)) / 2**20

    def check_space(self) -> None:
        """Refuse uploads that would use up the reserve.

        Raises:
            HttpProblem: there is too little space.
        """
        if self.free_mb() < self.settings.reserve_mb:
            raise HttpProblem("no-space", 507, headers={"Retry-After": "120"})

    def close(self) -> None:
        """Let go of the database."""
        self.engine.dispose()


async def context_of(connection: HTTPConnection) -> Context:
    """The context of the application that got a request; asynchronous, as a hop to a thread would cost more."""
    context: Context = connection.app.state.context
    return context


async def tenant_of(connection: HTTPConnection) -> Tenant:
    """Who sent a request.

    Raises:
        HttpProblem: nobody whom this server knows.
    """
    tenant = (await context_of(connection)).keys.tenant(connection.headers)
    if tenant is None:
        raise HttpProblem("unauthorized", 401, headers={"WWW-Authenticate": "Bearer"})
    return tenant


Asking = Annotated[Tenant, Depends(tenant_of)]
Here = Annotated[Context, Depends(context_of)]
