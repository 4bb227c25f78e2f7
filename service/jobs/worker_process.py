"""The process of a worker: ``python -m service.jobs.worker_process``, settings as JSON on standard input."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import signal
import sys
import threading
from types import FrameType

import sqlalchemy as sa

from service.errors import AvatarError
from service.jobs import logs
from service.jobs.patience import TEMPORARY_FAILURE
from service.jobs.settings import from_json
from service.jobs.worker import Worker

log = logging.getLogger(__name__)


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
