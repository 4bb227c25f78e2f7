"""A stand-in for the service, as far as the page uses it: the interface is that of ``service.api``.

It serves the built page, takes photos, moves a job through its stages on a clock and hands out the files of an archive.
"""

from __future__ import annotations

import asyncio
import io
import json
import mimetypes
import socket
import threading
import time
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import uvicorn
from multipart import MultipartParser, parse_options_header
from starlette.applications import Starlette
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from service.api.front import SECURITY_HEADERS

STATIC = Path(__file__).resolve().parents[2] / "service" / "web" / "static"

STAGES = ["decode", "detect", "fit", "texture", "compare"]

LARGE = [6144, 4096]
SIZES = {"draft": [1536, 1024], "standard": LARGE, "high": LARGE, "reference": LARGE}
QUALITY = {
    "items": [
        {"quality": "draft", "size": [1536, 1024], "median_s": 5.6},
        {"quality": "standard", "size": LARGE, "median_s": 26.7},
        {"quality": "standard", "size": [1536, 1024], "median_s": 6.0},
    ],
    "levels": [{"name": name, "size": size} for name, size in SIZES.items()],
    "formats": ["jpeg", "png", "webp"],
    "choices": {
        "hair": ["auto", "none", "bob"], "hair_colour": ["auto", "red"], "eye_colour": ["auto", "blue"],
        "mouth": ["auto", "shut"], "wrinkles": ["auto", "older"],
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
        warnings: codes that every job ends with.
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
    warnings: list[str] = field(default_factory=lambda: ["low-resolution"])
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
            "warnings": self.warnings if good else [],
        }


def problem(code: str, status: int, title: str, detail: str, **extra: Any) -> dict[str, Any]:
    return {**extra, "type": f"/problems/{code}", "title": title, "status": status, "detail": detail, "code": code}


def refused(content: dict[str, Any]) -> Response:
    return JSONResponse(content, content["status"], media_type="application/problem+json")


def application(fake: Fake) -> Starlette:
    """The interface, as far as the page uses it, and the built page."""

    async def front(request: Request, go_on: RequestResponseEndpoint) -> Response:
        path = request.url.path
        fake.requests.append((request.method, path, dict(request.headers)))
        if path.startswith("/v1") and fake.key and request.headers.get("authorization") != f"Bearer {fake.key}":
            answer = refused(
                problem("unauthorized", 401, "A key is needed", "Send the access key that you were given.")
            )
        else:
            answer = await go_on(request)
        answer.headers.update(SECURITY_HEADERS)
        return answer

    async def quality(request: Request) -> Response:
        return JSONResponse(fake.quality)

    async def post(request: Request) -> Response:
        _, given = parse_options_header(request.headers["content-type"])
        parts = list(MultipartParser(io.BytesIO(await request.body()), given["boundary"]))
        options, *photos = [part.raw for part in parts if part.filename]
        for part in parts:
            part.close()
        if fake.refuse is not None:
            content, fake.refuse = fake.refuse, None
            return refused(content)
        name = fake.post(json.loads(options), photos)
        return JSONResponse(fake.state(name, 1), 202, {"Location": f"/v1/avatars/{name}"})

    async def export(request: Request) -> Response:
        wish = await request.json() if request.method == "POST" else request.path_params
        place = f"/v1/exports/{wish['avatar']}/{wish['for']}"
        state, status = ("running", 202) if request.method == "POST" else ("succeeded", 200)
        links = {"self": place, "kit": f"{place}/kit.zip"}
        return JSONResponse({"id": wish["for"], "state": state, "error": None, "links": links}, status)

    async def kit(request: Request) -> Response:
        return Response(KIT, media_type="application/zip")

    async def avatar(request: Request) -> Response:
        name, rest = request.path_params["name"], request.path_params.get("rest", "")
        if request.method == "DELETE":
            fake.deleted.append(name)
            return Response(status_code=204)
        if name in fake.gone:
            return refused(problem("gone", 410, "Gone", "It is gone.", reason=fake.gone[name]))
        if name not in fake.jobs or name in fake.deleted or (rest == "events" and not fake.streams):
            return refused(problem("not-found", 404, "Not found", "There is no such thing."))
        if not rest:
            return JSONResponse(fake.state(name, fake.count(name)))
        if rest == "events":
            at = int(request.headers.get("last-event-id") or 0)
            return StreamingResponse(events(fake, name, at), media_type="text/event-stream")
        if rest == "archive.zip":
            return Response(fake.archive.read_bytes(), media_type="application/zip")
        with zipfile.ZipFile(fake.archive) as archive:
            path = rest.removeprefix("files/")
            return Response(archive.read(path), media_type=mimetypes.guess_type(path)[0] or "application/octet-stream")

    routes = [
        Route("/v1/quality", quality),
        Route("/v1/avatars", post, methods=["POST"]),
        Route("/v1/avatars/{name}", avatar, methods=["GET", "DELETE"]),
        Route("/v1/avatars/{name}/{rest:path}", avatar),
        Route("/v1/exports", export, methods=["POST"]),
        Route("/v1/exports/{avatar}/{for}", export),
        Route("/v1/exports/{avatar}/{for}/kit.zip", kit),
        Mount("/", StaticFiles(directory=STATIC, html=True)),
    ]
    made = Starlette(routes=routes)
    made.add_middleware(BaseHTTPMiddleware, dispatch=front)
    return made


async def events(fake: Fake, name: str, at: int) -> AsyncIterator[str]:
    """Server-sent events of a job after the first ``at``."""
    for _ in range(fake.cut_after):
        if at == len(STAGES) + 2:
            return
        while at >= fake.count(name):
            await asyncio.sleep(fake.step_s / 4)
        at += 1
        state = fake.state(name, at)
        running = state["state"] == "running"
        data = {key: state[key] for key in ("state", "stage", "progress")} if running else state
        yield f"id: {at}\nevent: {'progress' if running else 'state'}\ndata: {json.dumps(data)}\n\n"


@contextmanager
def serving(archive: Path, **wishes: Any) -> Iterator[Fake]:
    """The stand-in on a free port of this machine."""
    fake = Fake(archive, **wishes)
    with socket.create_server(("127.0.0.1", 0)) as door:
        fake.address = f"http://127.0.0.1:{door.getsockname()[1]}"
        server = uvicorn.Server(uvicorn.Config(application(fake), log_level="error", lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [door]}, daemon=True)
        thread.start()
        try:
            yield fake
        finally:
            server.should_exit = server.force_exit = True
            thread.join()
