"""What makes an archive of one photo: a process on this machine, or a server."""

from __future__ import annotations

import contextlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.batch.plan import GROUP
from service.client.client import Client, Job, canonical, idempotency_key
from service.client.errors import (
    AccessDenied,
    ClientError,
    JobCancelled,
    JobExpired,
    JobFailed,
    NoSuchJob,
    Problem,
    ServerUnreachable,
    WaitTimedOut,
    failure,
)
from service.errors import AvatarError, Crashed, OutOfTime, OutputFault
from service.jobs.process import Ending, JobProcess, Task
from service.jobs.settings import Settings
from service.photo.bundle import unbundled
from service.places import file_sha256

LOG = "log"
"""Name of the file in the scratch folder for standard error of the process that makes a photo."""

TAIL = 2000
"""Bytes of the last words of a process that crashed, in the report."""

JOBS = 3
"""Jobs that one photo may use up at a server where they are cancelled or lost under our hands."""


@dataclass(frozen=True)
class Order:
    """One photo to be made into ``target``, whose folder is there; attempts count from 1.

    ``name`` is that of the report; what ``options``, JSON values, do not name has its default.
    """

    photo: Path
    name: str
    sha256: str
    options: Mapping[str, Any]
    attempt: int
    target: Path


class Stopped(Exception):
    """The run is to end."""


class Hopeless(Exception):
    """Nothing can be made any more, whatever the photo; ``error`` says why."""

    def __init__(self, error: AvatarError) -> None:
        super().__init__(error.message)
        self.error = error


class Maker(ABC):
    """Makes archives; threads share it."""

    @abstractmethod
    def make(self, order: Order, stop: Callable[[], bool]) -> list[str]:
        """Write a whole, checked archive to ``order.target``, or nothing; gives the warnings. True of ``stop`` ends it.

        AvatarError: why there is none. Stopped: it was to end. Hopeless: no photo will get through, this one or
        another.
        """

    def close(self) -> None:  # noqa: B027 - most have nothing to let go of
        """Called once, after the last ``make``."""


class LocalMaker(Maker):
    """Makes each photo in a process of its own, which ends with it and is limited by the settings.

    So memory stays flat over any number of photos, a crash in native code costs one photo, and a photo that never ends
    can be stopped.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    def make(self, order: Order, stop: Callable[[], bool]) -> list[str]:
        """See ``Maker.make``."""
        scratch = order.target.parent
        options = dict(order.options)
        task = Task(
            job=order.sha256, photo=str(order.photo.absolute()), photo_sha256=order.sha256, options=options,
            artifacts="", output=str(order.target.absolute()), scratch=str(scratch.absolute()),
        )  # fmt: skip
        started = threading.Event()
        process = JobProcess(self._settings, scratch / LOG)
        ending = process.run(task, lambda message: started.set() if "ready" in message else None, stop)
        if ending.kind == "stopped":
            raise Stopped
        if ending.kind == "crash" and not started.is_set():
            raise Hopeless(Crashed("the process that makes a photo cannot start; 'avatarme doctor' may say why"))
        if ending.kind != "done":
            raise self._fault(ending, scratch)
        stated = ending.facts.get("sha256")
        if stated is not None and stated != file_sha256(order.target):
            raise Crashed("the archive on the disk is not what was written")
        return [str(code) for code in ending.facts.get("warnings", [])]

    def _fault(self, ending: Ending, scratch: Path) -> Exception:
        if ending.kind == "problem":
            words = dict(ending.facts)
            problem = Problem(int(words.pop("status")), detail=str(words.pop("message")), extensions=words)
            return Hopeless(OutputFault(problem.message)) if problem.code == OutputFault.code else failure(problem)
        fault = ending.fault(self._settings)
        if isinstance(fault, OutOfTime):
            return OutOfTime(f"{fault.message}; --timeout allows more")
        return Crashed(fault.message, log=_tail(scratch / LOG)) if isinstance(fault, Crashed) else fault


def _tail(log: Path) -> str:
    with contextlib.suppress(OSError), log.open("rb") as stream:
        stream.seek(max(0, log.stat().st_size - TAIL))
        return stream.read().decode("utf-8", "replace")
    return ""


class RemoteMaker(Maker):
    """Hands photos to a server, waits, downloads, and erases what it downloaded unless it is to ``keep`` it.

    What was stopped in the middle is found again by the next run: the same photo, options and attempt are the same job,
    and a part of an archive, in the folder ``work``, is gone on from. ``timeout_s`` of one photo include waiting in the
    queue.
    """

    def __init__(self, server: str, api_key: str | None, work: Path, *, timeout_s: float, keep: bool) -> None:
        self._work = work
        self._timeout_s = timeout_s
        self._keep = keep
        with Client(server, api_key=api_key, attempts=4) as first:
            first.ready()
        # A full queue is no fault of a photo: as long as its time is not over, it waits for a place.
        self._client = Client(server, api_key=api_key, attempts=10_000, patience_s=timeout_s)

    def make(self, order: Order, stop: Callable[[], bool]) -> list[str]:
        """See ``Maker.make``."""
        end = time.monotonic() + self._timeout_s
        for again in range(JOBS):
            job = None
            try:
                job = self.submit(order, again)
                return self._collected(job, order, again, stop, end)
            except (ServerUnreachable, AccessDenied) as error:
                raise Hopeless(error) from error
            except (JobCancelled, JobExpired, JobFailed, NoSuchJob) as error:
                # One that failed before our eyes failed; one that lay there failed was left by another run.
                ours = isinstance(error, JobFailed) and (job is None or not job.ended)
                if ours or again == JOBS - 1:
                    raise
        raise AssertionError

    def close(self) -> None:
        """See ``Maker.close``."""
        self._client.close()

    def submit(self, order: Order, again: int) -> Job:
        """Hand a photo in; the same order is the same job."""
        photos = unbundled(order.photo.read_bytes()) if order.name.endswith(GROUP) else [order.photo]
        return self._client.submit(photos, order.options, key=_key(order, again))

    def _collected(self, job: Job, order: Order, again: int, stop: Callable[[], bool], end: float) -> list[str]:
        def told(*_: Any) -> None:
            if stop():
                raise Stopped

        try:
            done = self._client.wait(job.id, timeout_s=max(end - time.monotonic(), 1.0), progress=told)
        except WaitTimedOut:
            self._erase(job)
            raise
        part = self._work / f"{_key(order, again)}.zip"
        self._client.download(job.id, part, progress=told)
        part.replace(order.target)
        if not self._keep:
            self._erase(job)
        return list(done.warnings)

    def _erase(self, job: Job) -> None:
        with contextlib.suppress(ClientError):  # it expires anyway
            self._client.delete(job.id)


def _key(order: Order, again: int) -> str:
    """The name is in it too: photos that are copies of each other must not erase each other's job."""
    return idempotency_key(order.sha256, canonical(order.options), order.name, order.attempt, again)
