"""What is done beside the jobs: results expire, leftovers go, and no job is left standing."""

from __future__ import annotations

import logging
import time

import sqlalchemy as sa

from service.jobs.admission import UNFINISHED
from service.jobs.database import JOBS, WORKERS, now, seconds_of_database
from service.jobs.erasure import checkpoint, forget, let_go
from service.jobs.queue import Queue
from service.jobs.settings import PIPELINE_VERSION
from service.jobs.store import Row, workflows
from service.jobs.view import FINAL, problem
from service.jobs.workflow import Runner

log = logging.getLogger(__name__)

SETTLED = 5.0
"""Seconds after a change before leftovers of a job are looked for."""

LOST = 30.0
"""Seconds after which a job that this worker should run, and does not, means that the worker has to be restarted."""

SILENT = 60.0
"""Seconds without a sign of life after which another worker counts as dead."""


class LostJob(Exception):
    """A job is recorded as running here and is not: its thread died of a database that failed."""


class Janitor:
    """Housekeeping of one worker; each method may be called by many workers at once.

    Args:
        runner: of this worker.
        queue: the queue.
    """

    def __init__(self, runner: Runner, queue: Queue) -> None:
        self._runner = runner
        self._store = runner.store
        self._queue = queue
        self._missing: dict[str, float] = {}

    def expire(self) -> None:
        """Erase results whose time is over, and after a while all memory of them."""
        moment = now()
        for row in self._store.where(JOBS.c.state.in_(FINAL), JOBS.c.gone.is_(None), JOBS.c.expires_at < moment):
            let_go(self._store, self._queue, row, "expired")
        tombstone = moment - self._runner.settings.tombstone_hours * 3600
        for row in self._store.where(JOBS.c.gone.is_not(None), JOBS.c.updated_at < tombstone):
            self._queue.delete(workflows(row))
            forget(self._store.engine, row["id"])
        checkpoint(self._store.engine)

    def tidy(self) -> None:
        """Erase photos and stages of jobs that ended while nobody could do it."""
        rows = self._store.where(JOBS.c.state.in_(FINAL), JOBS.c.swept.is_(False), JOBS.c.updated_at < now() - SETTLED)
        for row in rows:
            if row["id"] in self._runner.active:
                continue
            if row["gone"] is not None or row["state"] == "cancelled":
                self._queue.delete(workflows(row))  # results of steps name files by their hashes
            self._runner.tidy(row["id"])

    def adopt(self) -> None:
        """Begin unfinished jobs of older versions of the program again, unless a worker of that version lives."""
        alive = self._alive()
        for status in self._queue.unfinished():
            version = status.app_version
            if version in (None, PIPELINE_VERSION) or alive.get(status.executor_id or "") == version:
                continue
            row = self._by_workflow(status.workflow_id)
            self._queue.cancel(status.workflow_id)
            if row is not None and row["state"] in UNFINISHED:
                self._again(row)
                log.info("a job of %s is begun again", version, extra={"job": row["id"]})

    def lead(self) -> None:
        """See to it that new jobs are for a version of the program that some worker has; as :meth:`Queue.lead`."""
        if self._queue.lead(PIPELINE_VERSION, set(self._alive().values())):
            log.warning("new jobs are now for workers of %s", PIPELINE_VERSION)

    def reconcile(self, *, working: bool = True) -> None:
        """No job that is unfinished for its owner may be finished, or unknown, for the queue.

        Args:
            working: whether this worker takes jobs; where not, those that are recorded as its own may stand.

        Raises:
            LostJob: one that should run here does not.
        """
        rows = self._store.where(JOBS.c.state.in_(UNFINISHED), JOBS.c.updated_at < now() - SETTLED)
        states = self._queue.states([row["workflow"] for row in rows])
        missing: dict[str, float] = {}
        for row in rows:
            status = states.get(row["workflow"])
            if status is None:
                log.error("a job was not in the queue and is put there", extra={"job": row["id"]})
                self._put(row)
            elif status.status in ("SUCCESS", "ERROR", "CANCELLED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED"):
                self._close(row, status.status)
            elif working and status.status == "PENDING" and status.executor_id == self._runner.settings.worker:
                missing[row["id"]] = self._missing.get(row["id"], time.monotonic())
        self._missing = {job: since for job, since in missing.items() if job not in self._runner.active}
        if any(time.monotonic() - since > LOST for since in self._missing.values()):
            raise LostJob(", ".join(self._missing))

    def silent(self) -> set[str]:
        """Names of other workers that hold unfinished jobs and give no sign of life, or take no jobs for a fault."""
        alive = self._alive()
        holders = {status.executor_id for status in self._queue.unfinished() if status.status == "PENDING"}
        return {name for name in holders if name and name not in alive} - {self._runner.settings.worker}

    def holders(self) -> set[str]:
        """Names of other workers that hold unfinished jobs."""
        statuses = self._queue.unfinished()
        holders = {status.executor_id for status in statuses if status.status == "PENDING" and status.executor_id}
        return holders - {self._runner.settings.worker}

    def _alive(self) -> dict[str, str]:
        """Name -> version of the workers that gave a sign of life and take jobs."""
        engine = self._store.engine
        query = sa.select(WORKERS.c.name, WORKERS.c.version).where(
            WORKERS.c.seen_at > seconds_of_database(engine) - SILENT, WORKERS.c.fault.is_(None)
        )
        with engine.connect() as connection:
            return {row.name: row.version for row in connection.execute(query)}

    def _close(self, row: Row, status: str) -> None:
        expires = now() + self._runner.settings.result_hours * 3600
        if status == "CANCELLED":
            closed = self._store.cancel(row["id"], expires)
        else:
            log.error("a job ended without an answer: %s", status, extra={"job": row["id"]})
            words = "the computation ended again and again without an answer"
            closed = self._store.fail(row["id"], problem("crashed", 500, words), expires)
        if closed:
            self._runner.tidy(row["id"])

    def _again(self, row: Row) -> None:
        job, _, count = str(row["workflow"]).partition(".")
        workflow = f"{job}.{int(count) + 1}"
        with self._store.engine.begin() as connection:
            query = sa.update(JOBS).where(JOBS.c.id == job, JOBS.c.workflow == row["workflow"])
            if connection.execute(query.values(workflow=workflow)).rowcount:
                self._queue.put(connection, {**row, "workflow": workflow})

    def _put(self, row: Row) -> None:
        with self._store.engine.begin() as connection:
            self._queue.put(connection, row)

    def _by_workflow(self, workflow: str) -> Row | None:
        rows = self._store.where(JOBS.c.workflow == workflow)
        return rows[0] if rows else None
