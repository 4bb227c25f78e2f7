"""Archives made by a server."""

from __future__ import annotations

import contextlib
import threading
import time
from pathlib import Path

from service.batch.maker import Hopeless, Order, Progress, Stopped
from service.client.client import Client, Job, canonical, idempotency_key
from service.client.errors import (
    AccessDenied,
    ClientError,
    JobCancelled,
    JobExpired,
    JobFailed,
    NoSuchJob,
    ServerUnreachable,
    WaitTimedOut,
)
from service.client.retry import Retry

_JOBS = 3
"""Jobs that one attempt may use up where they are cancelled or lost under our hands."""

_SENT, _MADE = 0.05, 0.9
"""Shares of the bar: up to here the photo goes up; between the two the server works; then the archive comes down."""


class RemoteMaker:
    """Hands photos to a server, waits, downloads, and erases what it downloaded.

    What was stopped in the middle is found again by the next run: the same photo, options and attempt are the same
    job, and a part of an archive is gone on from.

    Args:
        server: address.
        api_key: None where the server wants none.
        work: folder for files on their way, on the file system of the archives.
        timeout_s: longest time of one photo, waiting in the queue included.
        keep: leave the archives on the server until they expire.
    """

    def __init__(self, server: str, api_key: str | None, work: Path, *, timeout_s: float, keep: bool) -> None:
        self._work = work
        self._timeout_s = timeout_s
        self._keep = keep
        self._stopped = threading.Event()
        with Client(server, api_key=api_key, retry=Retry(attempts=4, sleep=self._sleep)) as first:
            first.ready()
        # A full queue is no fault of a photo: as long as its time is not over, it waits for a place.
        retry = Retry(attempts=10_000, patience_s=timeout_s, sleep=self._sleep)
        self._client = Client(server, api_key=api_key, retry=retry)

    def make(self, order: Order, progress: Progress) -> list[str]:
        """See ``Maker.make``."""
        try:
            return self._make(order, progress)
        except (ServerUnreachable, AccessDenied) as error:
            raise Hopeless(error) from error

    def stop(self) -> None:
        """See ``Maker.stop``. Jobs that were handed in go on; the next run collects them."""
        self._stopped.set()

    def close(self) -> None:
        """See ``Maker.close``."""
        self._client.close()

    def _make(self, order: Order, told: Progress) -> list[str]:
        end = time.monotonic() + self._timeout_s

        def progress(stage: str, share: float) -> None:
            if self._stopped.is_set():
                raise Stopped
            told(stage, share)

        progress("send", 0.0)
        for again in range(_JOBS - 1):
            job = None
            try:
                job = self._submit(order, again)
                return self._collect(job, order, again, progress, end)
            except (JobCancelled, JobExpired, JobFailed, NoSuchJob) as error:
                if isinstance(error, JobFailed) and (job is None or not job.ended):
                    raise  # it failed before our eyes; one that lay there failed was left by another run
        return self._collect(self._submit(order, _JOBS - 1), order, _JOBS - 1, progress, end)

    def _submit(self, order: Order, again: int) -> Job:
        return self._client.submit(order.photo, order.options, key=_key(order, again))

    def _collect(self, job: Job, order: Order, again: int, progress: Progress, end: float) -> list[str]:
        scaled = lambda stage, share: progress(stage, _SENT + (_MADE - _SENT) * share)  # noqa: E731
        try:
            done = self._client.wait(job.id, timeout_s=max(end - time.monotonic(), 1.0), progress=scaled)
        except WaitTimedOut:
            self._erase(job)
            raise
        part = self._work / f"{_key(order, again)}.zip"

        def coming(have: int, total: int | None) -> None:
            progress("download", _MADE + (1 - _MADE) * have / total if total else _MADE)

        self._client.download(job.id, part, progress=coming)
        part.replace(order.target)
        if not self._keep:
            self._erase(job)
        return list(done.warnings)

    def _erase(self, job: Job) -> None:
        with contextlib.suppress(ClientError):  # it expires anyway
            self._client.delete(job.id)

    def _sleep(self, seconds: float) -> None:
        if self._stopped.wait(seconds):
            raise Stopped


def _key(order: Order, again: int) -> str:
    """The name is in it too: photos that are copies of each other must not erase each other's job."""
    return idempotency_key(order.sha256, canonical(order.options), order.name, order.attempt, again)
