"""``avatarme serve``: the HTTP server, and beside it the worker that it looks after."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import FrameType
from typing import Any, cast

import h11
import uvicorn
from fastapi import Depends, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import STATUS_PHRASES, H11Protocol

from service import __version__
from service.api import avatars, downloads, info, problem_responses, renders_and_exports
from service.api.context import Context
from service.api.front import Front, Heads, no_strange_parameters
from service.api.keys import LOOPBACK, check_exposed, make_first_key
from service.api.openapi import described
from service.api.problem_responses import EXPLANATIONS, MEDIA_TYPE
from service.jobs import logs
from service.jobs.database import FileLock
from service.jobs.process import give_back_memory, keep_private
from service.jobs.settings import Settings
from service.jobs.view import problem
from service.photo.gate import expect_photo

PAGE = Path(__file__).parents[1] / "web" / "static"
"""Folder of the page at ``/``."""


def create_app(settings: Settings) -> FastAPI:
    """The application, by the settings of the server."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        context = await run_in_threadpool(Context, settings)
        app.state.context = context
        await run_in_threadpool(expect_photo)
        try:
            yield
        finally:
            context.draining.set()
            await run_in_threadpool(context.engine.dispose)

    app = FastAPI(
        title="avatarme", version=__version__, lifespan=lifespan, docs_url=None, redoc_url=None,
        description="One photo of a face in, a renderable head out.", redirect_slashes=False,
    )  # fmt: skip
    problem_responses.install(app)
    app.add_middleware(Heads)
    app.add_middleware(Front, settings=settings)
    derived = (renders_and_exports.renders, renders_and_exports.exports)
    for router in (avatars.router, downloads.router, *derived, info.router):
        app.include_router(router, dependencies=[Depends(no_strange_parameters)])
    files = _Page(directory=PAGE, html=True)
    # Not one mount for all: it would take every address of the interface that is asked for with a wrong method.
    for path in ("", *sorted(file.relative_to(PAGE).as_posix() for file in PAGE.rglob("*") if file.is_file())):
        app.router.routes.append(Route(f"/{path}", files, methods=["GET", "HEAD"], include_in_schema=False))
    app.openapi = lambda: described(app)  # type: ignore[method-assign]
    return app


class _Page(StaticFiles):
    """Files that a browser may keep, and has to ask about each time: a new version is seen at once."""

    def file_response(self, *arguments: Any, **named: Any) -> Response:
        """The answer with a static file, with ``Cache-Control``."""
        answer = super().file_response(*arguments, **named)
        answer.headers["Cache-Control"] = "no-cache"
        return answer


def protocol_class(header_seconds: float, connections: int, stalled_seconds: float = 60.0) -> type[H11Protocol]:
    """The protocol with deadlines: of a head from the connection, or the first byte of a further request, to its end.

    One address may have so many ``connections`` open at a time, 0 for any number. A reader may leave what was written
    to it unread for ``stalled_seconds`` before its connection is closed. What is kept for it is at most the transport's
    buffer, so this also is a least speed.
    """

    class GuardedProtocol(H11Protocol):
        """One connection."""

        _deadline: asyncio.TimerHandle | None = None
        _stall: asyncio.TimerHandle | None = None

        def pause_writing(self) -> None:
            super().pause_writing()
            self._stall = self.loop.call_later(stalled_seconds, self.transport.abort)

        def resume_writing(self) -> None:
            self._reading_goes_on()
            super().resume_writing()

        def _reading_goes_on(self) -> None:
            if self._stall is not None:
                self._stall.cancel()
                self._stall = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            peers = [getattr(other, "client", None) or ("",) for other in self.connections]
            own = self.client[0] if self.client else ""
            if connections and sum(peer[0] == own for peer in peers) > connections:
                transport.abort()
                return
            self._wait()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop_waiting()
            self._reading_goes_on()
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            if self._deadline is None and self.conn.their_state is h11.IDLE:
                self._wait()
            super().data_received(data)
            if self.conn.their_state is not h11.IDLE:
                self._stop_waiting()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            if self.conn.their_state is not h11.IDLE:
                self._stop_waiting()

        def send_400_response(self, msg: str) -> None:
            self._refuse(400, "bad-request")

        def _wait(self) -> None:
            self._deadline = self.loop.call_later(header_seconds, self._too_slow)

        def _stop_waiting(self) -> None:
            if self._deadline is not None:
                self._deadline.cancel()
                self._deadline = None

        def _too_slow(self) -> None:
            self._deadline = None
            if self.transport.is_closing() or self.conn.their_state is not h11.IDLE:
                return
            if self.cycle is not None and not self.cycle.response_complete:
                return
            self._refuse(408, "request-timeout")

        def _refuse(self, status: int, code: str) -> None:
            if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
                self.transport.close()
                return
            body = json.dumps(problem(code, status, EXPLANATIONS[code])).encode()
            headers = [
                (b"content-type", MEDIA_TYPE.encode()),
                (b"content-length", str(len(body)).encode()),
                (b"x-content-type-options", b"nosniff"),
                (b"connection", b"close"),
            ]
            answer = h11.Response(status_code=status, headers=headers, reason=STATUS_PHRASES[status])
            for event in (answer, h11.Data(data=body), h11.EndOfMessage()):
                self.transport.write(cast(bytes, self.conn.send(cast(Any, event))))
            self.transport.close()

    return GuardedProtocol


log = logging.getLogger(__name__)

DRAIN_S = 30
"""Seconds that requests have to finish in when the server is told to end."""

_SHORTEST, _LONGEST = 0.5, 30.0
_STEADY = 60.0


class WorkerKeeper:
    """Keeps one worker process running."""

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
            self._process = _started(self._settings)
            if self._stopping.is_set():
                self._process.terminate()
            status = self._process.wait()
            if self._stopping.is_set():
                return
            pause = _SHORTEST if time.monotonic() - begin > _STEADY else min(pause * 2, _LONGEST)
            log.error("the worker ended with status %d and is started again in %.1f s", status, pause)
            self._stopping.wait(pause)


class _Server(uvicorn.Server):
    """Stops taking photos as soon as a signal comes; the second signal ends it at once.

    After SIGTERM requests are answered for ``notice`` seconds, so that whoever asks ``/readyz`` hears of it before
    connections are refused.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI, notice: float) -> None:
        super().__init__(config)
        self._app = app
        self._notice = notice
        self._ends_at: float | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal came."""
        self.force_exit = self.should_exit = self._ends_at is not None
        self._ends_at = time.monotonic() + (self._notice if sig == signal.SIGTERM else 0.0)
        context = getattr(self._app.state, "context", None)
        if context is not None:
            context.draining.set()

    async def on_tick(self, counter: int) -> bool:
        """Whether to end now; asked ten times a second."""
        if self._ends_at is not None and time.monotonic() >= self._ends_at:
            self.should_exit = True
        return await super().on_tick(counter)


def serve(settings: Settings, *, with_worker: bool = True) -> None:
    """Serve until a signal ends it, without a worker where these run elsewhere (``avatarme worker``).

    UsageError: another server has the data folder, or others could use this one without a key.
    """
    check_exposed(settings.host, settings.keys, anybody=settings.anybody)
    logs.set_up()
    give_back_memory()
    keep_private(settings.data)
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
    server = _Server(config, app, settings.notice_seconds)
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


def work(settings: Settings, module: str = "service.jobs.worker") -> int:
    """Run a worker alone until a signal ends it; returns its exit status. ``module`` is the program of its process."""
    process = _started(settings, module)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, frame: process.send_signal(number))
    return process.wait()


def _started(settings: Settings, module: str = "service.jobs.worker") -> subprocess.Popen[bytes]:
    """The process of a worker, with its settings on standard input."""
    process = subprocess.Popen(  # noqa: S603 - our own interpreter and our own module, no shell
        [sys.executable, "-m", module, str(os.getpid())], stdin=subprocess.PIPE
    )
    with contextlib.suppress(OSError):  # it has ended already
        if process.stdin is not None:
            process.stdin.write(settings.to_json().encode() + b"\n")
            process.stdin.close()
    return process
