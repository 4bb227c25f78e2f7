"""What is done beside the jobs: results expire, leftovers go, and no job is left standing."""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Mapping

import sqlalchemy as sa

from service.jobs.database import IS_LEFTOVER, IS_TOMBSTONE, JOBS, WORKERS, now, seconds_of_database
from service.jobs.locks import DatabaseLock
from service.jobs.runner import Runner
from service.jobs.store import Row, checkpoint, forget, let_go, workflows
from service.jobs.view import FINAL, problem

log = logging.getLogger(__name__)

SETTLED = 5.0
"""Seconds after a change before leftovers of a job are looked for."""

LOST = 30.0
"""Seconds after which a job that this worker should run, and does not, means that the worker has to be restarted."""

HEAD = 16
"""Jobs of each kind whose turns come next that are looked at."""

_TAKE_OVER = 4242003
"""Advisory lock of Postgres."""

STRAY = 3600.0
"""Seconds for which files of a job that nobody knows are seen before they go: the job may be about to be stored."""

SILENT = 60.0
"""Seconds without a sign of life after which another worker counts as dead."""


class LostJob(Exception):
    """A job is recorded as running here and is not: its thread died of a database that failed."""


class Janitor:
    """Housekeeping of one worker; each method may be called by many workers at once.

    Nothing here takes longer with a longer queue: what runs is looked at as a whole, and of what waits the head, which
    a job that the queue forgot reaches as soon as all before it are served.
    """

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._store = runner.store
        self._queue = runner.store.queue
        self._missing: dict[str, float] = {}
        self._quiet: set[str] = set()
        self._unknown: dict[str, float] = {}

    def expire(self) -> None:
        """Erase results whose time is over, and after a while all memory of them."""
        moment = now()
        for row in self._store.where(JOBS.c.state.in_(FINAL), JOBS.c.gone.is_(None), JOBS.c.expires_at < moment):
            let_go(self._store, row, "expired")
        tombstone = moment - self._runner.settings.tombstone_hours * 3600
        for row in self._store.where(IS_TOMBSTONE, JOBS.c.updated_at < tombstone):
            self._queue.delete(workflows(row))
            forget(self._store.engine, row["id"])
        checkpoint(self._store.engine)

    def tidy(self) -> None:
        """Erase photos and stages of jobs that ended while nobody could do it."""
        for row in self._store.where(IS_LEFTOVER, JOBS.c.updated_at < now() - SETTLED):
            if row["id"] in self._runner.active:
                continue
            if row["gone"] is not None or row["state"] == "cancelled":
                self._queue.delete(workflows(row))  # results of steps name files by their hashes
            self._runner.tidy(row["id"])

    def sweep_strays(self) -> None:
        """Remove files without a job that have been there for long: of a server that died between storing a photo and
        its job.
        """
        artifacts, moment = self._runner.artifacts, time.monotonic()
        found = artifacts.jobs()
        unknown = set(found) - set(self._store.versions(found))
        self._unknown = {job: self._unknown.get(job, moment) for job in unknown}
        for job, since in self._unknown.items():
            if moment - since >= STRAY:
                artifacts.sweep(job, set())

    def reconcile(self, *, working: bool = True) -> None:
        """No job that is unfinished for its owner may be finished or unknown for the queue.

        Those that are recorded as this worker's own may stand where it is not ``working``; where it is, one that does
        not run here is a :class:`LostJob`.
        """
        rows = [row for row in self._store.at_work(HEAD) if row["updated_at"] < now() - SETTLED]
        states = self._queue.states([row["workflow"] for row in rows])
        missing: dict[str, float] = {}
        for row in rows:
            status = states.get(row["workflow"])
            if status is None:
                log.error("a job was not in the queue and is put there", extra={"job": row["id"]})
                with self._store.engine.begin() as connection:
                    self._queue.put(connection, row)
            elif status.status in ("SUCCESS", "ERROR", "CANCELLED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED"):
                self._close(row, status.status)
            elif working and status.status == "PENDING" and status.executor_id == self._runner.settings.worker:
                missing[row["id"]] = self._missing.get(row["id"], time.monotonic())
        self._missing = {job: since for job, since in missing.items() if job not in self._runner.active}
        if any(time.monotonic() - since > LOST for since in self._missing.values()):
            raise LostJob(", ".join(self._missing))

    def others(self, connection: sa.Connection) -> dict[str, bool]:
        """Names of the other workers, and whether they are silent or take no jobs for a fault."""
        silent = (WORKERS.c.seen_at <= seconds_of_database(self._store.engine) - SILENT) | WORKERS.c.fault.is_not(None)
        query = sa.select(WORKERS.c.name, silent).where(WORKERS.c.name != self._runner.settings.worker)
        return {name: bool(is_silent) for name, is_silent in connection.execute(query)}

    def dead(self, others: Mapping[str, bool], lock: DatabaseLock) -> set[str]:
        """Names of other workers that are dead.

        Those are it whose lock is free, which Postgres sees as soon as their connection ends; DBOS has nothing of the
        kind. (A killed worker's jobs were taken over after 2 s, a frozen one's after 67 s.) Those too that gave no sign
        of life, or take no jobs for a fault, twice in a row: a clock that is set forward makes all workers silent until
        their next sign of life. SQLAlchemyError: ``lock``, of this worker's name, may be lost.
        """
        quiet = {name for name, is_silent in others.items() if is_silent}
        dead, self._quiet = lock.dead(others) | (quiet & self._quiet), quiet
        return dead

    def take_over(self, dead: Collection[str]) -> int:
        """Put the jobs of dead workers back into the queue, on Postgres; returns their number."""
        if not dead:
            return 0
        with self._store.engine.begin() as connection:  # one worker at a time: what was taken over may run already
            connection.execute(sa.text("set local idle_in_transaction_session_timeout = '60s'"))
            free = sa.text("select pg_try_advisory_xact_lock(:key)")
            if not connection.execute(free, {"key": _TAKE_OVER}).scalar_one():
                return 0
            taken = self._queue.take_from(dead)
        if taken:
            log.warning("jobs of workers that are gone are taken over: %d", taken)
        return taken

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
