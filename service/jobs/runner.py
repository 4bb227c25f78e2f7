"""The steps of a job here: a process of its own for each attempt, again where the fault was not the photo's."""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import shutil
import threading
import time
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from service.errors import Crashed, ModelFault
from service.jobs.artifacts import Artifacts, artifact_name, kept_folder
from service.jobs.database import JOBS, now, patient
from service.jobs.process import Ending, Glance, JobProcess, Task
from service.jobs.settings import Settings
from service.jobs.store import Row, Store
from service.jobs.view import FINAL, KINDS, Kind, from_error, from_facts, problem
from service.places import file_sha256

log = logging.getLogger(__name__)

LOOK = 0.7
"""Seconds between two looks at the database for a cancellation."""

WRITE = 0.5
"""Seconds between two reports of progress within a stage."""


class Report:
    """Progress from the process to the database, not too often; a report that fails is left out."""

    def __init__(self, store: Store, job: str) -> None:
        self._store, self._job = store, job
        self._stage, self._at = "", 0.0

    def __call__(self, message: dict[str, Any]) -> None:
        """Take a line of the process: a stage that begins, or one that is kept."""
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


LOSSES = 10
"""How often in a row its whole worker may be lost with a job, without a stage finished in between, before it fails.

Somebody who kills the worker now and then meets other jobs, or later stages of this one. A job that takes the worker
along each time, as where a container is ended as a whole for its memory, must not do so for ever.
"""


SPACE = 2.0
"""Seconds between two looks for space on the disk."""

CRASHES = 3
OUT_OF_MEMORY = 2
"""How often a job's process may crash, or run out of memory, before the job fails.

After the first time without enough memory it has to get by with less (``Task.tight``).
"""

AFTERMATH = 1.0
"""Seconds after the violent end of a job's process in which the end of the worker may follow.

Who kills everything reaches one process after the other, and that is no crash of the job.
"""


class Runner:
    """The steps of a job on this machine, its processes, and what is decided by how they end."""

    def __init__(self, settings: Settings, store: Store, artifacts: Artifacts) -> None:
        self.settings = settings
        self.store = store
        self.artifacts = artifacts
        self.stopping = threading.Event()
        self.active: dict[str, JobProcess | None] = {}
        self.scratch = (settings.data / "scratch" / settings.worker).resolve()
        self.doubt = threading.Event()
        """Set when a job found a data file damaged."""
        self._spare: JobProcess | None = None
        self._lock = threading.Lock()

    def accept(self, workflow: str) -> dict[str, Any]:
        """First step: the job whose turn this is runs, if there is one."""
        job = patient(lambda: self.store.begin(workflow))
        return {"kind": "ended"} if job is None else {"kind": "wanted", "job": job}

    def make(self, job: str) -> dict[str, Any]:
        """Second step: compute the archive in a process of its own.

        Gives ``kind`` "done" with the facts of the archive, "problem" with a problem object, or "ended" where the job
        has ended meanwhile.
        """
        row = self._row(job)
        if row is None or row["state"] in FINAL:
            return {"kind": "ended"}
        scratch = self.scratch / f"{job}-{secrets.token_hex(4)}"
        scratch.mkdir(parents=True, mode=0o700)
        self.active[job] = None
        try:
            return self.outcome(row, scratch)
        finally:
            self.active.pop(job, None)
            shutil.rmtree(scratch, ignore_errors=True)

    def publish(self, job: str, outcome: dict[str, Any]) -> str:
        """Last step: the owner sees the outcome, and what is no longer needed is erased.

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

    def free_mb(self) -> float:
        """Free space in MiB where stages and archives are written."""
        return self.artifacts.free_mb(self.scratch)

    def outcome(self, row: Row, scratch: Path) -> dict[str, Any]:
        """Try until there is one: ``kind`` "done", "problem" or "ended", as :meth:`Runner.make` says."""
        job, kind = row["id"], KINDS[row["kind"]]
        while True:
            self._wait_for_space(job)
            photo = scratch if kind.derived else self._photo(row, scratch)
            if photo is None:
                return _failed(FileNotFoundError(row["photo"])) if self._wanted(job) else {"kind": "ended"}
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
            if ending.kind == "stopped":
                return {"kind": "ended"}
            found = self._problem(job, kind, ending)
            if found is not None:
                return {"kind": "problem", "problem": found}

    def _problem(self, job: str, kind: Kind, ending: Ending) -> dict[str, Any] | None:
        """What a job fails for whose process ended so; None where it is worth another attempt."""
        limits = kind.limits(self.settings)
        if ending.kind == "problem" and not ending.starved:
            return from_facts(ending.facts)
        if ending.kind == "time":
            if kind.derived:
                return problem(f"{kind.name}-timeout", 504, kind.slow.format(seconds=limits.job_seconds))
            return from_error(ending.fault(limits))
        log.error("the process of a job ended", extra={"job": job, "kind": ending.kind, "status": ending.status})
        if ending.starved:
            again = patient(lambda: self.store.count(job, JOBS.c.starved)) < OUT_OF_MEMORY
            return None if again else from_error(ending.fault(limits))
        crashes = patient(lambda: self.store.count(job, JOBS.c.crashes))
        return None if crashes < CRASHES else from_error(Crashed(f"the computation crashed {crashes} times"))

    def _once(self, row: Row, photo: Path, scratch: Path) -> Ending:
        job, kind = row["id"], KINDS[row["kind"]]
        source = patient(lambda: self.store.get(row["source"])) if kind.derived else None
        if kind.derived and (source is None or source["archive"] is None):
            gone = {"code": "gone", "status": 410, "message": "the avatar has expired or was erased"}
            return Ending("problem", gone, 0)
        process = None
        if not kind.derived:
            with self._lock:
                process, self._spare = self._spare, None
        if process is None or not process.alive():
            process = JobProcess(kind.limits(self.settings))
        self.active[job] = process
        progress = (lambda message: None) if kind.derived else Report(self.store, job)
        task = task_of(row, source, self.settings, scratch, photo)
        ended = Glance(lambda: self._gone(job), LOOK)
        return process.run(task, progress, lambda: self.stopping.is_set() or ended())

    def _wait_for_space(self, job: str) -> None:
        """A job begins when the reserve is free, which is enough for its stages and its archive."""
        told = False
        while patient(self.free_mb) < self.settings.reserve_mb and not self.stopping.is_set() and self._wanted(job):
            if not told:
                log.error("a job waits for space on the disk", extra={"job": job, "free_mb": round(self.free_mb())})
            told = True
            time.sleep(SPACE)

    def _photo(self, row: Row, scratch: Path) -> Path | None:
        """Path of the photo on this machine, None where it is gone."""
        if not row["photo"]:  # cancelled meanwhile
            return None

        def fetch() -> Path | None:
            with contextlib.suppress(FileNotFoundError):
                return self.artifacts.local(row["photo"], scratch)
            return None

        return patient(fetch)

    def _store(self, row: Row, facts: dict[str, Any], scratch: Path) -> dict[str, Any]:
        kind = KINDS[row["kind"]]
        file = scratch / kind.file
        if kind.derived:
            facts = {
                "sha256": file_sha256(file), "bytes": file.stat().st_size, "warnings": [], "timings": {},
                "peak_rss_mb": None, "facts": facts,
            }  # fmt: skip
        name = artifact_name(row["id"], kind.artifact, facts["sha256"], file.suffix.removeprefix("."))
        if file.exists():
            patient(lambda: self.artifacts.put(file, name))
        return {"kind": "done", "archive": name, **facts}

    def _row(self, job: str) -> Row | None:
        return patient(lambda: self.store.get(job))

    def _wanted(self, job: str) -> bool:
        return patient(lambda: self.store.wanted(job))

    def _gone(self, job: str) -> bool:
        """Whether the job has ended because its owner wants it to, as far as the database says."""
        with contextlib.suppress(sa.exc.SQLAlchemyError):
            return not self.store.wanted(job)
        return False


def task_of(row: Row, source: Row | None, settings: Settings, scratch: Path, photo: Path) -> Task:
    """What the process of a job is told.

    ``source`` is, of a derived kind, the row of the job whose archive it is made of, and its ``photo`` is any path.
    """
    kind, options = KINDS[row["kind"]], json.loads(row["options"])
    if source is not None:
        options = {"archive": source["archive"], "request": options["request"]}
    return Task(
        job=row["id"], photo=str(photo), photo_sha256=row["photo_sha256"], options=options,
        artifacts=settings.artifacts_url, output=str(scratch / kind.file), scratch=str(scratch),
        tight=row["starved"] > 0, stages=kept_folder(row["tenant"], row["photo_sha256"]) if row["keep_photo"] else "",
    )  # fmt: skip


def _failed(error: Exception) -> dict[str, Any]:
    return {"kind": "problem", "problem": from_error(error)}
