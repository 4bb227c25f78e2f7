"""A small server of the HTTP contract that can be told to misbehave."""

from __future__ import annotations

import email.parser
import email.policy
import hashlib
import json
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Handler = Callable[["_Handler"], None]


@dataclass
class Seen:
    """One request that reached the server."""

    method: str
    path: str
    headers: dict[str, str]
    at: float


@dataclass
class Fake:
    """What the server knows, and what it is told to do wrong.

    Attributes:
        faults: (method, pattern of the path) -> handlers, each of which answers one request instead of the server.
        cut_archive: byte counts after which the next downloads break.
        stages: of a job, which is one further with every question, and then ends.
        error: problem object with which jobs end, None for success.
    """

    archive: bytes = b""
    etag: str | None = None
    stages: list[str] = field(default_factory=lambda: ["decode", "fit", "texture"])
    error: dict[str, Any] | None = None
    end: str = ""
    faults: dict[tuple[str, str], deque[Handler]] = field(default_factory=dict)
    cut_archive: deque[int] = field(default_factory=deque)
    seen: list[Seen] = field(default_factory=list)
    jobs: dict[str, dict[str, Any]] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    photos: dict[str, bytes] = field(default_factory=dict)
    url: str = ""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def fail(self, method: str, pattern: str, *handlers: Handler) -> None:
        self.faults.setdefault((method, pattern), deque()).extend(handlers)

    def requests(self, method: str, pattern: str = "") -> list[Seen]:
        return [seen for seen in self.seen if seen.method == method and re.search(pattern, seen.path)]

    def etag_header(self) -> str:
        return f'"{hashlib.sha256(self.archive).hexdigest()}"' if self.etag is None else self.etag


def answer(status: int, content: Any = None, **headers: str) -> Handler:
    """A handler that answers with JSON; ``Retry_After="1"`` is a header."""

    def handle(request: _Handler) -> None:
        request.swallow()
        kind = "application/problem+json" if status >= 400 else "application/json"
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        request.reply(
            status, json.dumps(content).encode() if content is not None else b"", {"Content-Type": kind, **named}
        )

    return handle


def hang_up(request: _Handler) -> None:
    """Close the connection without a word."""
    request.close_connection = True
    request.connection.shutdown(socket.SHUT_RDWR)


def problem(status: int, code: str, detail: str = "what was wrong", **extra: Any) -> dict[str, Any]:
    return {"type": f"/problems/{code}", "title": code, "status": status, "detail": detail, "code": code, **extra}


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    fake: Fake
    _body: bytes | None = None

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        self._handle()

    do_POST = do_DELETE = do_GET

    def _handle(self) -> None:
        fake, self._body = self.fake, None
        with fake.lock:
            fake.seen.append(Seen(self.command, self.path, dict(self.headers.items()), time.monotonic()))
            fault = next(
                (
                    handlers.popleft()
                    for (method, pattern), handlers in fake.faults.items()
                    if method == self.command and re.search(pattern, self.path) and handlers
                ),
                None,
            )
        if fault is not None:
            fault(self)
        elif self.command == "POST" and self.path == "/v1/avatars":
            self._submit()
        elif found := re.fullmatch(r"/v1/avatars/(\w+)(/archive\.zip)?", self.path):
            self._job(found[1], found[2])
        elif self.path == "/readyz":
            answer(200, {"path": self.path})(self)
        else:
            answer(404, problem(404, "not-found"))(self)

    def swallow(self) -> bytes:
        """The body, read once."""
        if self._body is None:
            self._body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        return self._body

    def reply(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _submit(self) -> None:
        fake, key = self.fake, self.headers["Idempotency-Key"]
        head = f"Content-Type: {self.headers['Content-Type']}\r\n\r\n".encode()
        parts = email.parser.BytesParser(policy=email.policy.HTTP).parsebytes(head + self.swallow())
        content = {part.get_param("name", header="Content-Disposition"): part for part in parts.iter_parts()}
        with fake.lock:
            job = fake.keys.get(key)
            if job is None:
                job = fake.keys[key] = f"{len(fake.keys):032x}"
                fake.photos[job] = content["image"].get_content()
                options = json.loads(content["options"].get_content())
                fake.jobs[job] = {"id": job, "state": "queued", "stage": "", "progress": 0.0, "options": options}
        answer(202, fake.jobs[job], Location=f"/v1/avatars/{job}")(self)

    def _job(self, job: str, part: str | None) -> None:
        fake = self.fake
        if job not in fake.jobs:
            answer(404, problem(404, "not-found"))(self)
        elif self.command == "DELETE":
            del fake.jobs[job]
            self.reply(204, b"", {})
        elif part == "/archive.zip":
            self._archive()
        else:
            self._advance(job)
            answer(200, fake.jobs[job])(self)

    def _advance(self, job: str) -> None:
        """One stage further with every question."""
        state = self.fake.jobs[job]
        done = state.setdefault("done", 0)
        if done < len(self.fake.stages):
            state.update(
                state="running", stage=self.fake.stages[done], progress=done / len(self.fake.stages), done=done + 1
            )
        elif state["state"] in ("queued", "running"):
            self._finish(job)

    def _finish(self, job: str) -> None:
        end = self.fake.end or ("failed" if self.fake.error else "succeeded")
        self.fake.jobs[job].update(state=end, stage="", progress=1.0, error=self.fake.error, done=len(self.fake.stages))

    def _archive(self) -> None:
        fake, data, start = self.fake, self.fake.archive, 0
        wanted = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range", ""))
        if wanted:
            start = int(wanted[1])
        if start and start >= len(data):
            self.reply(416, b"", {"Content-Range": f"bytes */{len(data)}"})
            return
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
        self.send_header("Content-Length", str(len(data) - start))
        if fake.etag_header():
            self.send_header("ETag", fake.etag_header())
        self.end_headers()
        cut = fake.cut_archive.popleft() if fake.cut_archive else None
        self.wfile.write(data[start:] if cut is None else data[start : start + cut])
        if cut is not None:
            self.wfile.flush()
            hang_up(self)


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, address: Any) -> None:
        """A client that went away is what these tests are about."""


@contextmanager
def serving(fake: Fake) -> Iterator[Fake]:
    """Serve on a free port of this machine."""
    handler = type("Handler", (_Handler,), {"fake": fake})
    with _Server(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        fake.url = f"http://127.0.0.1:{server.server_port}"
        try:
            yield fake
        finally:
            server.shutdown()
            thread.join()
