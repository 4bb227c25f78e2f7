"""Tells many listeners that a job has new events, with one look at the database for all of them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Iterator

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from service.jobs.store import Store

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
