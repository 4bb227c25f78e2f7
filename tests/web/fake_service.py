"""A stand-in for the service, as far as the page uses it: the interface is that of ``service.api``.

It serves the built page, takes photos, moves a job through its stages on a clock and hands out the files of an archive.
"""

from __future__ import annotations

import json
import mimetypes
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from service.api.front import SECURITY_HEADERS

STATIC = Path(__file__).resolve().parents[2] / "service" / "web" / "static"

STAGES = ["decode", "detect", "fit", "texture", "compare"]

LARGE = [6144, 4096]
SIZES = {"draft": [1536, 1024], "standard": LARGE, "high": LARGE, "reference": LARGE}
QUALITY = {
    "items": [
        {"quality": "draft", "size": [1536, 1024], "median_s": 8.2},
        {"quality": "standard", "size": LARGE, "median_s": 41.0},
        {"quality": "standard", "size": [1536, 1024], "median_s": 9.0},
    ],
    "levels": [{"name": name, "size": size} for name, size in SIZES.items()],
    "formats": ["jpeg", "png", "webp"],
    "choices": {
        "hair": ["auto", "none", "bob"], "hair_colour": ["auto", "red"], "eye_colour": ["auto", "blue"],
        "mouth": ["auto", "shut"],
    },
}  # fmt: skip
KIT = b"PK\x05\x06" + bytes(18)
"""A zip without files, which stands for every kit."""


@dataclass
class Fake:
    """What the stand-in is to do, and what it was asked.

    Attributes:
        archive: path of the zip whose files it hands out.
        step_s: time of one stage.
        error: problem object that the next job ends with; used once.
        refuse: problem that the next POST gets; used once.
        streams: whether there are event streams.
        cut_after: the event stream breaks after so many events, each time.
        key: the access key that is wanted.
        quality: what GET /v1/quality answers.
        gone: jobs whose results are gone, and why: "expired", "erased", "lost".
    """

    archive: Path
    step_s: float = 0.12
    error: dict[str, Any] | None = None
    refuse: dict[str, Any] | None = None
    streams: bool = True
    cut_after: int = 10**9
    key: str = ""
    quality: dict[str, Any] = field(default_factory=lambda: QUALITY)
    gone: dict[str, str] = field(default_factory=dict)
    jobs: dict[str, float] = field(default_factory=dict)
    errors: dict[str, dict[str, Any]] = field(default_factory=dict)
    deleted: list[str] = field(default_factory=list)
    options: list[dict[str, Any]] = field(default_factory=list)
    photos: list[list[bytes]] = field(default_factory=list)
    requests: list[tuple[str, str, dict[str, str]]] = field(default_factory=list)
    address: str = ""

    def post(self, options: dict[str, Any], photos: list[bytes]) -> str:
        name = f"job-{len(self.jobs)}-{'x' * 20}"
        self.options.append(options)
        self.photos.append(photos)
        self.jobs[name] = time.monotonic()
        if self.error is not None:
            self.errors[name], self.error = self.error, None
        return name

    def count(self, name: str) -> int:
        """Number of events of a job so far: queued, one per stage, the final state."""
        return min(int((time.monotonic() - self.jobs[name]) / self.step_s) + 1, len(STAGES) + 2)

    def state(self, name: str, at: int) -> dict[str, Any]:
        """State of a job after its event ``at``, counted from 1."""
        over = at == len(STAGES) + 2
        good = over and name not in self.errors
        address = f"/v1/avatars/{name}"
        final = "succeeded" if good else "failed"
        return {
            "id": name,
            "state": final if over else "queued" if at == 1 else "running",
            "stage": "" if at == 1 or over else STAGES[at - 2],
            "progress": 1.0 if over else (at - 1) / (len(STAGES) + 1),
            "expires_at": "2046-11-22T09:30:00.000Z" if over else None,
            "links": {
                "self": address,
                "events": f"{address}/events",
                "archive": f"{address}/archive.zip" if good else None,
                "files": f"{address}/files" if good else None,
            },
            "error": self.errors.get(name) if over else None,
            "warnings": ["low-resolution"] if good else [],
        }


def problem(code: str, status: int, title: str, detail: str, **extra: Any) -> dict[str, Any]:
    return {**extra, "type": f"/problems/{code}", "title": title, "status": status, "detail": detail, "code": code}


class Handler(BaseHTTPRequestHandler):
    """One request."""

    fake: Fake
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the tests read ``fake.requests``."""

    def do_GET(self) -> None:
        path = self._begin()
        page = STATIC / (path[1:] or "index.html")
        if page.is_file() and page.resolve().is_relative_to(STATIC):
            return self._send(200, str(mimetypes.guess_type(page.name)[0]), page.read_bytes())
        if not self._allowed():
            return None
        if path == "/v1/quality":
            return self._json(200, self.fake.quality)
        if path.startswith("/v1/exports/"):
            avatar, tool, *file = path.removeprefix("/v1/exports/").split("/")
            ready = self._export(avatar, tool, "succeeded")
            return self._send(200, "application/zip", KIT) if file else self._json(200, ready)
        name, _, rest = path.removeprefix("/v1/avatars/").partition("/")
        if name in self.fake.gone:
            return self._problem(problem("gone", 410, "Gone", "It is gone.", reason=self.fake.gone[name]))
        if name not in self.fake.jobs or name in self.fake.deleted:
            return self._problem(problem("not-found", 404, "Not found", "There is no such avatar."))
        if not rest:
            return self._json(200, self.fake.state(name, self.fake.count(name)))
        if rest == "events":
            return self._events(name) if self.fake.streams else self._problem(problem("gone", 404, "No", "No."))
        if rest == "archive.zip":
            return self._send(200, "application/zip", self.fake.archive.read_bytes())
        return self._member(rest.removeprefix("files/"))

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_POST(self) -> None:
        self._begin()
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if not self._allowed():
            return None
        if self.fake.refuse is not None:
            content, self.fake.refuse = self.fake.refuse, None
            return self._problem(content)
        if self.path == "/v1/exports":
            wish = json.loads(body)
            return self._json(202, self._export(wish["avatar"], wish["for"], "running"))
        parts = _parts(body, self.headers["Content-Type"])
        name = self.fake.post(json.loads(parts["options"][0]), parts["image"])
        return self._json(202, self.fake.state(name, 1), {"Location": f"/v1/avatars/{name}"})

    def do_DELETE(self) -> None:
        self.fake.deleted.append(self._begin().removeprefix("/v1/avatars/"))
        self._send(204, "", b"")

    @staticmethod
    def _export(avatar: str, tool: str, state: str) -> dict[str, Any]:
        address = f"/v1/exports/{avatar}/{tool}"
        return {"id": tool, "state": state, "error": None, "links": {"self": address, "kit": f"{address}/kit.zip"}}

    def _begin(self) -> str:
        path = self.path.partition("?")[0]
        self.fake.requests.append((self.command, path, {k.lower(): v for k, v in self.headers.items()}))
        return path

    def _allowed(self) -> bool:
        if not self.fake.key or self.headers.get("Authorization") == f"Bearer {self.fake.key}":
            return True
        self._problem(problem("unauthorized", 401, "A key is needed", "Send the access key that you were given."))
        return False

    def _events(self, name: str) -> None:
        at = int(self.headers.get("Last-Event-ID") or 0)
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        self.close_connection = True
        sent = 0
        while at < len(STAGES) + 2 and sent < self.fake.cut_after:
            if at >= self.fake.count(name):
                time.sleep(self.fake.step_s / 4)
                continue
            at, sent = at + 1, sent + 1
            state = self.fake.state(name, at)
            kind = "progress" if state["state"] == "running" else "state"
            data = state if kind == "state" else {"stage": state["stage"], "progress": state["progress"]}
            text = f"id: {at}\nevent: {kind}\ndata: {json.dumps({**data, 'state': state['state']})}\n\n"
            try:
                self.wfile.write(text.encode())
            except OSError:  # the page went away
                return

    def _member(self, path: str) -> None:
        with zipfile.ZipFile(self.fake.archive) as archive:
            if path not in archive.namelist():
                return self._problem(problem("not-found", 404, "Not found", f"There is no {path}."))
            return self._send(200, mimetypes.guess_type(path)[0] or "application/octet-stream", archive.read(path))

    def _json(self, status: int, content: object, headers: dict[str, str] | None = None) -> None:
        self._send(status, "application/json", json.dumps(content).encode(), headers)

    def _problem(self, content: dict[str, Any]) -> None:
        self._send(content["status"], "application/problem+json", json.dumps(content).encode())

    def _send(self, status: int, kind: str, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            **SECURITY_HEADERS,
            **(headers or {}),
        }.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def _parts(body: bytes, kind: str) -> dict[str, list[bytes]]:
    """Parts of a multipart body by name."""
    parts: dict[str, list[bytes]] = {}
    for part in body.split(b"--" + kind.partition("boundary=")[2].encode())[1:-1]:
        head, _, content = part.partition(b"\r\n\r\n")
        name = head.partition(b'name="')[2].partition(b'"')[0].decode()
        parts.setdefault(name, []).append(content.removesuffix(b"\r\n"))
    return parts


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Browsers drop connections as they like."""


@contextmanager
def serving(archive: Path, **wishes: Any) -> Iterator[Fake]:
    """The stand-in on a free port of this machine."""
    fake = Fake(archive, **wishes)
    server = _Server(("127.0.0.1", 0), type("Bound", (Handler,), {"fake": fake}))
    fake.address = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield fake
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
