"""Attempts at a job on this machine: a process of its own each time, again where the fault was not the photo's."""

from __future__ import annotations

import json
import logging
import shutil
import threading
import time
from pathlib import Path
from typing import Any

from service.errors import Crashed, OutOfMemory, OutOfTime
from service.jobs import derived
from service.jobs.artifacts import Artifacts, artifact_name
from service.jobs.kinds import KINDS, Kind
from service.jobs.lookups import Row
from service.jobs.patience import patient
from service.jobs.problems import from_error
from service.jobs.process import Ending, JobProcess
from service.jobs.settings import Settings
from service.jobs.store import Store
from service.jobs.suspicion import LOSSES, rest
from service.jobs.view import FINAL
from service.jobs.watching import Report, Stop
from service.jobs.wire import Task

log = logging.getLogger(__name__)

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


class Attempts:
    """The processes of jobs on this machine, and what is decided by how they end.

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
        self.active: dict[str, JobProcess | None] = {}
        self.scratch = (settings.data / "scratch" / settings.worker).resolve()
        self._spare: JobProcess | None = None
        self._lock = threading.Lock()

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
        folder = self.artifacts.folder or self.settings.data
        return min(shutil.disk_usage(path).free for path in (folder, self.scratch)) / 2**20

    def outcome(self, row: Row, scratch: Path) -> dict[str, Any]:
        """Try until there is one: ``kind`` "done", "problem" or "ended", as :meth:`Runner.make` says."""
        job, kind = row["id"], KINDS[row["kind"]]
        while True:
            self._wait_for_space(job)
            photo = scratch if kind.derived else self._photo(row, scratch)
            if photo is None:
                return {"kind": "ended"} if self._ended(job) else _failed(FileNotFoundError(row["photo"]))
            rest(self.store, job, self.stopping)
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
            problem = self._problem(job, kind, ending)
            if problem is not None:
                return {"kind": "problem", "problem": problem}

    def _problem(self, job: str, kind: Kind, ending: Ending) -> dict[str, Any] | None:
        """What a job fails for whose process ended so; None where it is worth another attempt."""
        starved = ending.kind == "memory" or ending.facts.get("code") == OutOfMemory.code
        if ending.kind == "problem" and not starved:
            return ending.facts
        if ending.kind == "time":
            seconds = kind.limits(self.settings).job_seconds
            words = f"the computation took more than {seconds:g} s"
            return derived.too_slow(kind, seconds) if kind.derived else from_error(OutOfTime(words))
        log.error("the process of a job ended", extra={"job": job, "kind": ending.kind, "status": ending.status})
        if starved:
            again = patient(lambda: self.store.starved(job)) < OUT_OF_MEMORY
            return None if again else from_error(OutOfMemory(self._memory(ending)))
        crashes = patient(lambda: self.store.crashed(job))
        return None if crashes < CRASHES else from_error(Crashed(f"the computation crashed {crashes} times"))

    def _memory(self, ending: Ending) -> str:
        if ending.status < 0:
            return "the system ended the computation, as it does where the machine runs out of memory"
        return f"the computation needs more than the {self.settings.memory_mb} MiB that it may have"

    def _once(self, row: Row, photo: Path, scratch: Path) -> Ending:
        job, kind = row["id"], KINDS[row["kind"]]
        stop = Stop(self.store, job, self.stopping)
        if kind.derived:
            source = patient(lambda: self.store.get(row["source"]))
            if source is None or source["archive"] is None:
                return Ending("problem", derived.gone(), 0)
            process = JobProcess(kind.limits(self.settings))
            self.active[job] = process
            return process.run(derived.task(kind, row, source, self.settings, scratch), lambda message: None, stop)
        task = Task(
            job=job, photo=str(photo), photo_sha256=row["photo_sha256"], options=json.loads(row["options"]),
            artifacts=self.settings.artifacts_url, output=str(scratch / kind.file), scratch=str(scratch),
            tight=row["starved"] > 0,
        )  # fmt: skip
        with self._lock:
            spare, self._spare = self._spare, None
        process = spare if spare is not None and spare.alive() else JobProcess(self.settings)
        self.active[job] = process
        return process.run(task, Report(self.store, job), stop)

    def _wait_for_space(self, job: str) -> None:
        """A job begins when the reserve is free, which is enough for its stages and its archive."""
        told = False
        while patient(self.free_mb) < self.settings.reserve_mb and not self.stopping.is_set() and not self._ended(job):
            if not told:
                log.error("a job waits for space on the disk", extra={"job": job, "free_mb": round(self.free_mb())})
            told = True
            time.sleep(SPACE)

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
        kind = KINDS[row["kind"]]
        file = scratch / kind.file
        if kind.derived:
            facts = patient(lambda: derived.facts(file, facts))
        name = artifact_name(row["id"], kind.artifact, facts["sha256"], file.suffix.removeprefix("."))
        if file.exists():
            patient(lambda: self.artifacts.put(file, name))
        return {"kind": "done", "archive": name, **facts}

    def _row(self, job: str) -> Row | None:
        return patient(lambda: self.store.get(job))

    def _ended(self, job: str) -> bool:
        row = self._row(job)
        return row is None or row["state"] in FINAL


def _failed(error: Exception) -> dict[str, Any]:
    return {"kind": "problem", "problem": from_error(error)}
