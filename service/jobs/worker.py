"""A worker: takes jobs from the queue, and keeps house: results expire, leftovers go, no job is left standing.

As a process it is ``python -m service.jobs.worker``, with its settings as JSON on standard input.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from types import FrameType

import sqlalchemy as sa

from service import __version__
from service.errors import AvatarError
from service.jobs import logs
from service.jobs.artifacts import Artifacts
from service.jobs.database import (
    IS_LEFTOVER,
    IS_TOMBSTONE,
    JOBS,
    PATIENCE,
    TEMPORARY_FAILURE,
    WORKERS,
    DatabaseLock,
    FileLock,
    connect,
    create_tables,
    now,
    seconds_of_database,
)
from service.jobs.process import end_with_parent, keep_private
from service.jobs.runner import Runner
from service.jobs.settings import Settings, from_json
from service.jobs.store import Row, Store, checkpoint, forget, let_go, workflows
from service.jobs.view import FINAL, problem
from service.jobs.workflow import Workflows

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
        unknown = set(artifacts.jobs()) - self._store.known()
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


BEAT = 5.0
"""Seconds between two signs of life."""
LOOKS_APART = 6
"""Signs of life between two looks at data files that are damaged."""


class Worker:
    """One worker, from its start to its end; ``more`` gives what it does besides jobs.

    UsageError: another process has the data folder or the name.
    """

    def __init__(self, settings: Settings, more: Callable[[Worker], Sequence[Workflows]] = lambda worker: ()) -> None:
        self.settings = settings
        self._more = more
        self._file_lock = FileLock(settings.data, f"worker-{settings.worker}")
        self.engine = connect(settings.database_url, ping=False)
        self._lock = DatabaseLock(self.engine, settings.worker)
        create_tables(self.engine, settings)
        self.runner = Runner(settings, Store(self.engine), Artifacts(settings.artifacts_url))
        shutil.rmtree(self.runner.scratch, ignore_errors=True)
        self._janitor = Janitor(self.runner)
        self._failing_since: float | None = None

    def run(self) -> None:
        """Work until the process is told to end."""
        self._janitor.reconcile(working=False)
        self.wait_for_data()
        if self.runner.stopping.is_set():
            return
        self.beat()
        self._launch()
        # What is done beside the jobs, and the seconds between two times of doing it.
        chores: dict[Callable[[], None], float] = {
            self.beat: BEAT, self._janitor.tidy: 10.0, self._janitor.reconcile: 10.0,
            self._janitor.expire: 30.0, self._janitor.sweep_strays: 600.0,
        }  # fmt: skip
        next_time = dict.fromkeys(chores, 0.0)
        while not self.runner.stopping.wait(0.5):
            self.runner.warm()
            self.doubt()
            for chore, interval in chores.items():
                if time.monotonic() >= next_time[chore]:
                    next_time[chore] = time.monotonic() + interval
                    self._do(chore)
            self.runner.warm()

    def beat(self, fault: str | None = None) -> None:
        """Give a sign of life, take over what dead workers were at, and end where the lock on the name is lost.

        With a ``fault`` it takes no jobs.
        """
        values = {
            "version": __version__, "ready": fault is None, "fault": fault, "seen_at": seconds_of_database(self.engine),
        }  # fmt: skip
        with self.engine.begin() as connection:
            query = sa.update(WORKERS).where(WORKERS.c.name == self.settings.worker).values(**values)
            if not connection.execute(query).rowcount:
                connection.execute(sa.insert(WORKERS).values(name=self.settings.worker, **values))
            others = self._janitor.others(connection)
        try:
            dead = self._janitor.dead(others, self._lock)
        except sa.exc.SQLAlchemyError:
            self.quit("the lock on the name may be lost")
        if fault is None:
            self._janitor.take_over(dead)

    def wait_for_data(self) -> None:
        """Return when the data files are whole and all networks can be loaded, or this worker is told to end."""
        while (fault := "; ".join(faults(self.settings))) and not self.runner.stopping.is_set():
            log.critical("this worker takes no jobs: %s", fault)
            for _ in range(LOOKS_APART):
                self._do(partial(self.beat, fault))
                self._do(self._janitor.expire)
                if self.runner.stopping.wait(BEAT):
                    return

    def doubt(self) -> None:
        """End where a job has said that a data file is damaged, and one is: after the next start it is waited for."""
        if self.runner.doubt.is_set():
            self.runner.doubt.clear()
            if found := faults(self.settings):
                self.quit("; ".join(found))

    def _launch(self) -> None:
        from service.jobs import workflow

        workflow.launch(self.settings, workflow.of_jobs(self.runner), *self._more(self))
        logs.set_up()  # the library has put a handler of its own in

    def _do(self, chore: Callable[[], None]) -> None:
        try:
            chore()
            self._failing_since = None
        except LostJob as lost:
            self.quit(f"jobs stand still: {lost}")
        except (sa.exc.SQLAlchemyError, OSError) as error:
            self._failing_since = self._failing_since or time.monotonic()
            log.warning("a chore failed: %s", error)
            if time.monotonic() - self._failing_since > PATIENCE:
                self.quit("database or disk cannot be reached")

    def quit(self, reason: str) -> None:
        """End this process at once; what it was at goes on elsewhere, or here after the next start."""
        log.critical("this worker ends: %s", reason)
        self.runner.stop()
        os._exit(TEMPORARY_FAILURE)


def main(more: Callable[[Worker], Sequence[Workflows]] = lambda worker: ()) -> int:
    """Read the settings and work; ``more`` as for :class:`Worker`."""
    logs.set_up()
    settings = from_json(sys.stdin.buffer.readline().decode())
    if threading.current_thread() is threading.main_thread() and len(sys.argv) > 1:
        end_with_parent(int(sys.argv[1]))
    keep_private(settings.data)
    try:
        worker = Worker(settings, more)
    except AvatarError as error:
        log.critical("%s", error.message)
        return error.exit_status
    stopped = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        worker.runner.stopping.set()
        if stopped.is_set():
            os._exit(0)
        stopped.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    try:
        worker.run()
    except (sa.exc.SQLAlchemyError, OSError) as error:
        log.critical("this worker cannot start or go on: %s", error)
        worker.runner.stop()
        os._exit(TEMPORARY_FAILURE)
    worker.runner.stop()
    with contextlib.suppress(OSError):
        shutil.rmtree(worker.runner.scratch, ignore_errors=True)
    logs.flush()
    os._exit(0)  # threads of steps wait for this


LOADING_TIMEOUT = 300.0

_LOAD = """
import json, sys
faults = []
try:
    from service.diagnosis import data_faults
    faults += data_faults()
    if not faults:
        from service.head.files import load_head
        from service.runtime.sessions import load_session, model_table
        load_head()
        for name, entry in model_table().items():
            if str(entry["file"]).endswith(".onnx"):
                load_session(name)
except Exception as error:
    faults.append(f"{type(error).__name__}: {error}")
print(json.dumps(faults))
"""


def faults(settings: Settings) -> list[str]:
    """One sentence for each thing that is not well; empty when all is, or where another program than the pipeline runs.

    Hashes of all data files are compared and all networks are loaded, in a process of its own: native code that crashes
    must not take the worker along, and loading brings the files into the system's cache.
    """
    if settings.program != "service.jobs.avatar_process":
        return []
    try:
        process = subprocess.run(  # noqa: S603 - our own interpreter and our own code
            [sys.executable, "-c", _LOAD], capture_output=True, text=True, timeout=LOADING_TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return [f"loading the networks took more than {LOADING_TIMEOUT:g} s"]
    lines = process.stdout.strip().splitlines()
    if process.returncode or not lines:
        return [f"loading the networks ended with status {process.returncode}"]
    return [str(fault) for fault in json.loads(lines[-1])]


if __name__ == "__main__":
    sys.exit(main())
