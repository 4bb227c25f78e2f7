"""The process that takes jobs from the queue: ``python -m service.jobs.worker``, settings as JSON on standard input."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

import sqlalchemy as sa

from service.errors import AvatarError
from service.jobs import logs
from service.jobs.artifacts import Artifacts
from service.jobs.database import TABLES, WORKERS, add_columns, connect, seconds_of_database
from service.jobs.janitor import Janitor, LostJob
from service.jobs.locks import TABLES_PATIENCE, DatabaseLock, FileLock
from service.jobs.queue import Queue
from service.jobs.runner import PATIENCE, TEMPORARY_FAILURE, Runner
from service.jobs.settings import PIPELINE_VERSION, Settings, from_json
from service.jobs.store import Store

log = logging.getLogger(__name__)

CHORES = {
    "beat": 2.0, "tidy": 5.0, "take_over": 5.0, "reconcile": 10.0, "expire": 30.0, "recheck": 30.0, "strays": 600.0,
    "tell": 2.0,
}  # fmt: skip
"""Name of each chore and the seconds between two times of doing it."""


class Worker:
    """One worker, from its start to its end.

    Args:
        settings: of this worker.

    Raises:
        UsageError: another process has the data folder or the name.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._file_lock = FileLock(settings.data, f"worker-{settings.worker}")
        self._engine = connect(settings.database_url)
        self._lock = DatabaseLock(self._engine, settings.worker)
        create_tables(self._engine, settings)
        self.runner = Runner(settings, Store(self._engine), Artifacts(settings.artifacts_url))
        shutil.rmtree(self.runner.scratch, ignore_errors=True)
        self._janitor = Janitor(self.runner, Queue(self._engine))
        self._silent: set[str] = set()
        self._ready = False
        self._fault: str | None = None
        self._failing_since: float | None = None
        self._telling: threading.Thread | None = None

    def run(self) -> None:
        """Work until the process is told to end."""
        self._janitor.adopt()
        self._check()
        self.beat()
        if self._fault is None:
            self._launch()
        next_time = {**dict.fromkeys(CHORES, 0.0), "recheck": time.monotonic() + CHORES["recheck"]}
        while not self.runner.stopping.wait(0.5):
            self.runner.warm()
            if self.runner.doubt.is_set():
                next_time["recheck"] = 0.0
            for chore, interval in CHORES.items():
                if time.monotonic() >= next_time[chore]:
                    next_time[chore] = time.monotonic() + interval
                    self._do(getattr(self, chore))
            self.runner.warm()

    def beat(self) -> None:
        """Give a sign of life, and end where the lock on the name is lost."""
        self._lock.check()
        values = {
            "version": PIPELINE_VERSION, "ready": self._ready, "fault": self._fault,
            "seen_at": seconds_of_database(self._engine),
        }  # fmt: skip
        with self._engine.begin() as connection:
            query = sa.update(WORKERS).where(WORKERS.c.name == self.settings.worker).values(**values)
            if not connection.execute(query).rowcount:
                connection.execute(sa.insert(WORKERS).values(name=self.settings.worker, **values))

    def tidy(self) -> None:
        """As :meth:`Janitor.tidy`."""
        self._janitor.tidy()

    def expire(self) -> None:
        """As :meth:`Janitor.expire`."""
        self._janitor.expire()

    def strays(self) -> None:
        """As :meth:`Janitor.strays`."""
        self._janitor.strays()

    def reconcile(self) -> None:
        """As :meth:`Janitor.reconcile`, :meth:`Janitor.adopt` and :meth:`Janitor.lead`."""
        self._janitor.reconcile(working=self._fault is None)
        self._janitor.adopt()
        if self._fault is None:
            self._janitor.lead()

    def tell(self) -> None:
        """Send what webhooks wait for, in a thread: whoever is told may take its time."""
        if self.settings.webhook_hosts and (self._telling is None or not self._telling.is_alive()):
            self._telling = threading.Thread(target=self._tell, name="webhooks", daemon=True)
            self._telling.start()

    def _tell(self) -> None:
        from service.jobs.webhooks.deliver import deliver

        try:
            deliver(self._engine, self.settings)
        except (sa.exc.SQLAlchemyError, OSError) as error:
            log.warning("webhooks cannot be sent: %s", error)

    def take_over(self) -> None:
        """Put the jobs of dead workers back into the queue: those whose lock is free, or that are silent."""
        if self._engine.dialect.name == "sqlite" or self._fault is not None:
            return
        from service.jobs import workflow

        # Twice in a row: a clock that is set forward makes all workers silent until their next sign of life.
        found = self._janitor.silent()
        silent, self._silent = found & self._silent, found
        for name in self._janitor.holders():
            if name in silent or self._lock.is_dead(name):
                log.warning("the jobs of worker %s are taken over: %d", name, workflow.take_over(name))

    def recheck(self) -> None:
        """Look at the data files again: while one is damaged, and when a job has said that one is.

        With whole files a worker that waited for them begins to work. One that finds a damaged file while it works ends
        and is started again, as jobs may be under way, and then takes none.
        """
        if self._fault is None:
            if not self.runner.doubt.is_set():
                return
            self.runner.doubt.clear()
            self._check()
            if self._fault is not None:
                self._quit(self._fault)
            return
        self._check()
        if self._fault is None:
            log.warning("the data files are whole again, and this worker takes jobs")
            try:
                self._launch()
            except (sa.exc.SQLAlchemyError, OSError) as error:
                self._quit(f"the queue cannot be reached: {error}")

    def stop(self) -> None:
        """End all processes of jobs; what they finished is kept, and goes on after the next start."""
        self.runner.stop()

    def _check(self) -> None:
        """Check the data files by their hashes, and that all networks can be loaded."""
        from service.jobs.readiness import faults

        before, found = self._fault, faults(self.settings)
        self._fault = "; ".join(found) or None
        self._ready = not found
        if self._fault not in (None, before):
            log.critical("this worker takes no jobs: %s", self._fault)

    def _launch(self) -> None:
        from service.jobs import workflow

        workflow.launch(self.settings, self.runner)
        logs.set_up()  # the library has put a handler of its own in

    def _do(self, chore: Callable[[], None]) -> None:
        try:
            chore()
            self._failing_since = None
        except LostJob as lost:
            self._quit(f"jobs stand still: {lost}")
        except (sa.exc.SQLAlchemyError, OSError) as error:
            self._failing_since = self._failing_since or time.monotonic()
            log.warning("a chore failed: %s", error)
            if chore == self.beat and self._engine.dialect.name != "sqlite":
                self._quit("the lock on the name may be lost")
            if time.monotonic() - self._failing_since > PATIENCE:
                self._quit("database or disk cannot be reached")

    def _quit(self, reason: str) -> None:
        log.critical("this worker ends: %s", reason)
        self.stop()
        os._exit(TEMPORARY_FAILURE)


def create_tables(engine: sa.Engine, settings: Settings) -> None:
    """Make the tables of the service and of DBOS where they are missing; several processes may do it at once."""
    from dbos import DBOS

    held = FileLock(settings.data, "tables", TABLES_PATIENCE) if settings.database_url.startswith("sqlite") else None
    try:
        with engine.begin() as connection:
            if engine.dialect.name != "sqlite":
                connection.execute(sa.text("select pg_advisory_xact_lock(4242001)"))
            TABLES.create_all(connection)
            add_columns(connection)
        logging.getLogger("dbos").setLevel(logging.WARNING)
        DBOS.migrate(settings.database_url)
    finally:
        if held is not None:
            held.release()


def main() -> int:
    """Read the settings and work."""
    logs.set_up()
    settings = from_json(sys.stdin.buffer.readline().decode())
    if threading.current_thread() is threading.main_thread() and len(sys.argv) > 1:
        _end_with_parent(int(sys.argv[1]))
    try:
        worker = Worker(settings)
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
        worker.stop()
        os._exit(TEMPORARY_FAILURE)
    worker.stop()
    with contextlib.suppress(OSError):
        shutil.rmtree(worker.runner.scratch, ignore_errors=True)
    logs.flush()
    os._exit(0)  # threads of steps wait for this


def _end_with_parent(parent: int) -> None:
    if sys.platform != "linux":
        return
    import ctypes

    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
