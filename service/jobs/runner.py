"""The steps of a job. They hand on names and hashes, never bytes, and may run twice at the same time."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import sqlalchemy as sa

from service.errors import Crashed, ModelFault, OutOfMemory, OutOfTime
from service.jobs import pictures
from service.jobs.artifacts import Artifacts, artifact_name
from service.jobs.clock import now
from service.jobs.problems import from_error
from service.jobs.process import Ending, JobProcess
from service.jobs.settings import Settings
from service.jobs.store import Row, Store
from service.jobs.view import FINAL
from service.jobs.wire import Task

T = TypeVar("T")

log = logging.getLogger(__name__)

TEMPORARY_FAILURE = 75
"""Exit status (EX_TEMPFAIL) of a worker that cannot reach its database or disk; it is started again."""

PATIENCE = 60.0
"""Seconds for which a step waits for its database or disk before the worker gives up."""

LOOK = 0.4
"""Seconds between two looks at the database for a cancellation."""

WRITE = 0.5
"""Seconds between two reports of progress within a stage."""

SPACE = 2.0
"""Seconds between two looks for space on the disk."""

CRASHES = 3
OUT_OF_MEMORY = 2
"""How often a job's process may crash, or run out of memory, before the job fails.

After the first time without enough memory it has to get by with less (``Task.tight``).
"""

LOSSES = 10
"""How often in a row its whole worker may be lost with a job, without a stage finished in between, before it fails.

Somebody who kills the worker now and then meets other jobs, or later stages of this one. A job that takes the worker
along each time, as where a container is ended as a whole for its memory, must not do so for ever.
"""

SUSPECTED = 3
REST, LONGEST_REST = 4.0, 60.0
"""After so many losses in a row a job rests before it is tried again: so many seconds, twice as many each time.

It is a test of the suspicion. If the worker is lost while the job rests, something else takes it along, and what was
lost before counts no more.
"""

AFTERMATH = 1.0
"""Seconds after the violent end of a job's process in which the end of the worker may follow.

Who kills everything reaches one process after the other, and that is no crash of the job.
"""


class Runner:
    """Runs jobs on this machine.

    Args:
        settings: of this worker.
        store: the jobs.
        artifacts: their files.
    """

    def __init__(self, settings: Settings, store: Store, artifacts: Artifacts) -> None:
        self.settings = settings
        self.store = store
        self.artifacts = artifacts
        self.stopping = threading.Event()
        self.doubt = threading.Event()
        """Set when a job found a data file damaged."""
        self.active: dict[str, JobProcess | None] = {}
        self.scratch = (settings.data / "scratch" / settings.worker).resolve()
        self._spare: JobProcess | None = None
        self._lock = threading.Lock()

    def accept(self, job: str, workflow: str) -> dict[str, Any]:
        """First step: the job runs, if it is still wanted."""
        row = self._row(job)
        if row is None or row["workflow"] != workflow or not patient(lambda: self.store.begin(job)):
            return {"kind": "ended"}
        return {"kind": "wanted"}  # no hash: what is returned is recorded in the database

    def make(self, job: str) -> dict[str, Any]:
        """Second step: compute the archive in a process of its own.

        Returns:
            ``kind`` "done" with the facts of the archive, "problem" with a problem object, or "ended" where the job
            has ended meanwhile.
        """
        row = self._row(job)
        if row is None or row["state"] in FINAL:
            return {"kind": "ended"}
        scratch = self.scratch / f"{job}-{secrets.token_hex(4)}"
        scratch.mkdir(parents=True, mode=0o700)
        self.active[job] = None
        try:
            return self._attempts(row, scratch)
        finally:
            self.active.pop(job, None)
            shutil.rmtree(scratch, ignore_errors=True)

    def publish(self, job: str, outcome: dict[str, Any]) -> str:
        """Last step: the owner sees the outcome, and what is no longer needed is erased.

        Returns:
            "published", or "lost" where the archive is not on the disk any more.
        """
        expires = now() + self.settings.result_hours * 3600
        if outcome["kind"] == "done":
            if not patient(lambda: self.artifacts.exists(outcome["archive"])):
                row = self._row(job)
                return "published" if row is None or row["state"] in FINAL else "lost"
            patient(lambda: self.store.succeed(job, outcome, expires))
        elif outcome["kind"] == "problem":
            patient(lambda: self.store.fail(job, outcome["problem"], expires))
            if outcome["problem"]["code"] == ModelFault.code:
                self.doubt.set()
        self.tidy(job)
        return "published"

    def tidy(self, job: str) -> None:
        """Erase what a job that has ended does not need: its stages, and its photo unless it is to be kept."""
        row = self._row(job)
        if row is None or row["state"] not in FINAL:
            return
        keep = {row["archive"]} if row["archive"] and row["gone"] is None else set()
        if row["keep_photo"] and row["photo"] and row["gone"] is None:
            keep.add(row["photo"])
        patient(lambda: self.artifacts.sweep(job, keep))
        patient(lambda: self.store.set(job, swept=True))

    def warm(self) -> None:
        """Have a process ready that has loaded the program; called by the main thread while nothing runs."""
        with self._lock:
            if self._spare is None and len(self.active) < self.settings.jobs and not self.stopping.is_set():
                self._spare = JobProcess(self.settings)

    def stop(self) -> None:
        """End all processes; steps then wait for the end of this one, so that nothing of it is recorded."""
        self.stopping.set()
        with self._lock:
            spare, self._spare = self._spare, None
        for process in [spare, *self.active.values()]:
            if process is not None:
                process.end()

    def _attempts(self, row: Row, scratch: Path) -> dict[str, Any]:
        job = row["id"]
        while True:
            self._wait_for_space(job)
            photo = self._photo(row, scratch) if row["kind"] == "avatar" else scratch
            if photo is None:
                return {"kind": "ended"} if self._ended(job) else _failed(FileNotFoundError(row["photo"]))
            self._rest(job)
            lost = patient(lambda: self.store.attempt(job))
            if lost >= LOSSES:
                return _failed(Crashed(f"the server went down {lost} times in a row while it computed this photo"))
            ending = self._once(self._row(job) or row, photo, scratch)
            if ending.status < 0:
                self.stopping.wait(AFTERMATH)
            patient(lambda: self.store.answered(job))
            if self.stopping.is_set():
                time.sleep(3600)  # the worker ends; this step must not be recorded as finished
            if ending.kind == "done":
                return self._store(row, ending.facts, scratch)
            starved = ending.kind == "memory" or ending.facts.get("code") == OutOfMemory.code
            if ending.kind == "problem" and not starved:
                return {"kind": "problem", "problem": ending.facts}
            if ending.kind == "stopped":
                return {"kind": "ended"}
            if ending.kind == "time":
                if row["kind"] == "render":
                    return {"kind": "problem", "problem": pictures.too_slow(self.settings.render_seconds)}
                return _failed(OutOfTime(f"the computation took more than {self.settings.job_seconds:g} s"))
            log.error("the process of a job ended", extra={"job": job, "kind": ending.kind, "status": ending.status})
            if starved:
                if patient(lambda: self.store.starved(job)) >= OUT_OF_MEMORY:
                    return _failed(OutOfMemory(self._memory(ending)))
                continue
            crashes = patient(lambda: self.store.crashed(job))
            if crashes >= CRASHES:
                return _failed(Crashed(f"the computation crashed {crashes} times with this photo"))

    def _memory(self, ending: Ending) -> str:
        if ending.status < 0:
            return "the system ended the computation, as it does where the machine runs out of memory"
        return f"the computation needs more than the {self.settings.memory_mb} MiB that it may have"

    def _once(self, row: Row, photo: Path, scratch: Path) -> Ending:
        job = row["id"]
        if row["kind"] == "render":
            source = patient(lambda: self.store.get(row["source"]))
            if source is None or source["archive"] is None:
                return Ending("problem", pictures.gone(), 0)
            task = pictures.task(row, source, self.settings, scratch)
            painter = JobProcess(pictures.limits(self.settings))
            self.active[job] = painter
            return painter.run(task, lambda message: None, _Stop(self, job))
        task = Task(
            job=job, photo=str(photo), photo_sha256=row["photo_sha256"], options=_json(row["options"]),
            artifacts=self.settings.artifacts_url, output=str(scratch / "archive.zip"), scratch=str(scratch),
            tight=row["starved"] > 0,
        )  # fmt: skip
        with self._lock:
            process, self._spare = self._spare, None
        if process is None or not process.alive():
            process = JobProcess(self.settings)
        self.active[job] = process
        return process.run(task, _Report(self.store, job), _Stop(self, job))

    def free_mb(self) -> float:
        """Free space in MiB where stages and archives are written."""
        folder = self.artifacts.folder or self.settings.data
        return min(shutil.disk_usage(path).free for path in (folder, self.scratch)) / 2**20

    def _wait_for_space(self, job: str) -> None:
        """A job begins when the reserve is free, which is enough for its stages and its archive."""
        told = False
        while patient(self.free_mb) < self.settings.reserve_mb and not self.stopping.is_set() and not self._ended(job):
            if not told:
                log.error("a job waits for space on the disk", extra={"job": job, "free_mb": round(self.free_mb())})
            told = True
            time.sleep(SPACE)

    def _rest(self, job: str) -> None:
        """Let a job rest that seems to take its worker along, unless the worker was lost while it did."""
        row = self._row(job)
        if row is None or not (row["resting"] or SUSPECTED <= row["losses"] < LOSSES):
            return
        if row["resting"]:
            log.warning("a worker was lost while a job that was suspected of it rested", extra={"job": job})
            patient(lambda: self.store.set(job, resting=0, losses=0))
            return
        patient(lambda: self.store.set(job, resting=1))
        until = time.monotonic() + min(REST * 2 ** (row["losses"] - SUSPECTED), LONGEST_REST)
        while time.monotonic() < until and not self.stopping.is_set() and not self._ended(job):
            self.stopping.wait(min(LOOK, max(until - time.monotonic(), 0.0)))
        patient(lambda: self.store.set(job, resting=0))

    def _photo(self, row: Row, scratch: Path) -> Path | None:
        """Path of the photo on this machine, None where it is gone."""
        if not row["photo"]:  # cancelled meanwhile
            return None
        if self.artifacts.folder is not None:
            path = self.artifacts.folder / row["photo"]
            return path if path.exists() else None
        path = scratch / "photo"

        def fetch() -> Path | None:
            try:
                source = self.artifacts.open(row["photo"])
            except FileNotFoundError:
                return None
            with source, path.open("wb") as target:
                shutil.copyfileobj(source, target)
            return path

        return patient(fetch)

    def _store(self, row: Row, facts: dict[str, Any], scratch: Path) -> dict[str, Any]:
        kind, file = "archive", scratch / "archive.zip"
        if row["kind"] == "render":
            kind, file = "picture", scratch / pictures.FILE
            facts = patient(lambda: pictures.facts(file, facts))
        name = artifact_name(row["id"], kind, facts["sha256"], file.suffix.removeprefix("."))
        if file.exists():
            patient(lambda: self.artifacts.put(file, name))
        return {"kind": "done", "archive": name, **facts}

    def _row(self, job: str) -> Row | None:
        return patient(lambda: self.store.get(job))

    def _ended(self, job: str) -> bool:
        row = self._row(job)
        return row is None or row["state"] in FINAL


class _Report:
    """Progress from the process to the database, not too often; a report that fails is left out."""

    def __init__(self, store: Store, job: str) -> None:
        self._store, self._job = store, job
        self._stage, self._at = "", 0.0

    def __call__(self, message: dict[str, Any]) -> None:
        if "kept" in message:
            with contextlib.suppress(sa.exc.SQLAlchemyError):
                self._store.answered(self._job)
        stage, share = message.get("stage"), message.get("share")
        if not isinstance(stage, str) or not isinstance(share, int | float):
            return
        if stage == self._stage and time.monotonic() - self._at < WRITE:
            return
        known, self._stage, self._at = self._stage, stage, time.monotonic()
        with contextlib.suppress(sa.exc.SQLAlchemyError):
            self._store.progress(self._job, stage, share, known)


class _Stop:
    """Whether a process is to end: the worker stops, or the job has ended because its owner wants it to."""

    def __init__(self, runner: Runner, job: str) -> None:
        self._runner, self._job, self._at = runner, job, 0.0

    def __call__(self) -> bool:
        if self._runner.stopping.is_set():
            return True
        if time.monotonic() - self._at < LOOK:
            return False
        self._at = time.monotonic()
        try:
            row = self._runner.store.get(self._job)
        except sa.exc.SQLAlchemyError:
            return False
        return row is None or row["state"] in FINAL


def patient(call: Callable[[], T]) -> T:
    """Call again and again while the database or the disk fails; after ``PATIENCE`` end this process.

    An exception would be recorded as the result of the step, and the job would fail for what is not its fault. A new
    process takes the step up again.
    """
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return call()
        except (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError, OSError) as error:
            log.warning("waiting for database or disk: %s", error)
            if time.monotonic() > deadline:
                log.critical("this worker cannot reach its database or disk and ends")
                os._exit(TEMPORARY_FAILURE)
        time.sleep(0.5)


def _failed(error: Exception) -> dict[str, Any]:
    return {"kind": "problem", "problem": from_error(error)}


def _json(text: str) -> Any:
    import json

    return json.loads(text)
