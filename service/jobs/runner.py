"""The steps of a job. They hand on names and hashes, never bytes, and may run twice at the same time."""

from __future__ import annotations

import secrets
import shutil
import threading
from typing import Any

from service.errors import ModelFault
from service.jobs.artifacts import Artifacts
from service.jobs.attempts import Attempts
from service.jobs.clock import now
from service.jobs.patience import patient
from service.jobs.settings import Settings
from service.jobs.store import Store
from service.jobs.view import FINAL


class Runner(Attempts):
    """Runs jobs on this machine.

    Args:
        settings: of this worker.
        store: the jobs.
        artifacts: their files.
    """

    def __init__(self, settings: Settings, store: Store, artifacts: Artifacts) -> None:
        super().__init__(settings, store, artifacts)
        self.doubt = threading.Event()
        """Set when a job found a data file damaged."""

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
            return self.outcome(row, scratch)
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
