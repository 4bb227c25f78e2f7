"""A worker: takes jobs from the queue, and does what has to be done beside them.

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
from collections.abc import Callable, Sequence
from functools import partial
from types import FrameType

import sqlalchemy as sa

from service import __version__
from service.errors import AvatarError
from service.jobs import logs
from service.jobs.artifacts import Artifacts
from service.jobs.database import PATIENCE, TEMPORARY_FAILURE, WORKERS, connect, create_tables, seconds_of_database
from service.jobs.janitor import Janitor, LostJob
from service.jobs.locks import DatabaseLock, FileLock
from service.jobs.process import end_with_parent, keep_private
from service.jobs.runner import Runner
from service.jobs.settings import Settings, from_json
from service.jobs.store import Store
from service.jobs.workflow import Workflows

log = logging.getLogger(__name__)

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
        chores = self._chores()
        next_time = dict.fromkeys(chores, 0.0)
        while not self.runner.stopping.wait(0.5):
            self.runner.warm()
            self.doubt()
            for chore, interval in chores.items():
                if time.monotonic() >= next_time[chore]:
                    next_time[chore] = time.monotonic() + interval
                    self._do(chore)
            self.runner.warm()

    def _chores(self) -> dict[Callable[[], None], float]:
        """What is done beside the jobs, and the seconds between two times of doing it."""
        return {
            self.beat: BEAT, self._janitor.tidy: 10.0, self._janitor.reconcile: 10.0,
            self._janitor.expire: 30.0, self._janitor.sweep_strays: 600.0,
        }  # fmt: skip

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
