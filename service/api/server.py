"""``avatarme serve``: the HTTP server, and beside it the worker that it looks after."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from service.api.app import create_app
from service.api.keys import LOOPBACK, check_exposed, make_first_key
from service.api.protocol import protocol_class
from service.jobs import logs
from service.jobs.locks import FileLock
from service.jobs.machine import give_back_memory
from service.jobs.settings import Settings

log = logging.getLogger(__name__)

DRAIN_S = 30
"""Seconds that requests have to finish in when the server is told to end."""

_SHORTEST, _LONGEST = 0.5, 30.0
_STEADY = 60.0


class WorkerKeeper:
    """Keeps one worker process running.

    Args:
        settings: handed to the worker.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._stopping = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        # The worker ends with the thread that started it, so this one lives as long as the server.
        self._thread = threading.Thread(target=self._keep, name="worker-keeper", daemon=True)

    def start(self) -> None:
        """Start the worker."""
        self._thread.start()

    def stop(self) -> None:
        """Tell the worker to end, and wait for it."""
        self._stopping.set()
        process = self._process
        if process is not None:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        self._thread.join(5)

    def _keep(self) -> None:
        pause = _SHORTEST
        while not self._stopping.is_set():
            begin = time.monotonic()
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and our own module, no shell
                [sys.executable, "-m", "service.jobs.worker", str(os.getpid())], stdin=subprocess.PIPE
            )
            with contextlib.suppress(OSError):
                if self._process.stdin is not None:
                    self._process.stdin.write(self._settings.to_json().encode() + b"\n")
                    self._process.stdin.close()
            if self._stopping.is_set():
                self._process.terminate()
            status = self._process.wait()
            if self._stopping.is_set():
                return
            pause = _SHORTEST if time.monotonic() - begin > _STEADY else min(pause * 2, _LONGEST)
            log.error("the worker ended with status %d and is started again in %.1f s", status, pause)
            self._stopping.wait(pause)


class _Server(uvicorn.Server):
    """Stops taking photos as soon as a signal comes; the second signal ends it at once."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal came."""
        if self.should_exit:
            self.force_exit = True
        context = getattr(self._app.state, "context", None)
        if context is not None:
            context.draining.set()
            context.watcher.wake_all()
        super().handle_exit(sig, frame)


def serve(settings: Settings, *, with_worker: bool = True) -> None:
    """Serve until a signal ends it.

    Args:
        settings: of the server.
        with_worker: False where workers run elsewhere (``avatarme worker``).

    Raises:
        UsageError: another server has the data folder, or others could use this one without a key.
    """
    logs.set_up()
    give_back_memory()
    check_exposed(settings.host, settings.keys, anybody=settings.anybody)
    if settings.first_key and (told := make_first_key(Path(settings.keys))):
        log.warning("there were no keys: one was made and is in %s; delete that file when you have it", told)
    if settings.host not in LOOPBACK and not settings.keys:
        log.warning("everybody who reaches %s may use this server, as it was told", settings.host)
    lock = FileLock(settings.data, "server")
    keeper = WorkerKeeper(settings) if with_worker else None
    app = create_app(settings)
    protocol = protocol_class(settings.header_seconds, settings.connections, settings.stalled_seconds)
    config = uvicorn.Config(
        app, host=settings.host, port=settings.port, http=protocol, ws="none", log_config=None, access_log=False,
        server_header=False, date_header=True, timeout_keep_alive=15, timeout_graceful_shutdown=DRAIN_S,
        h11_max_incomplete_event_size=64 << 10, lifespan="on", loop="asyncio",
    )  # fmt: skip
    server = _Server(config, app)
    if keeper is not None:
        keeper.start()
    for number in (signal.SIGTERM, signal.SIGINT):
        # uvicorn raises the signal once more at the end, when the worker is still to be stopped.
        signal.signal(number, lambda number, frame: None)
    try:
        server.run()
    finally:
        if keeper is not None:
            keeper.stop()
        lock.release()


def work(settings: Settings) -> int:
    """Run a worker alone until a signal ends it; returns its exit status."""
    process = subprocess.Popen(  # noqa: S603 - our own interpreter and our own module, no shell
        [sys.executable, "-m", "service.jobs.worker", str(os.getpid())], stdin=subprocess.PIPE
    )
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, frame: process.send_signal(number))
    if process.stdin is not None:
        process.stdin.write(settings.to_json().encode() + b"\n")
        process.stdin.close()
    return process.wait()
