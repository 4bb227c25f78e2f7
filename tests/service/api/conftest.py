from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import httpx2
import pytest
from starlette.testclient import TestClient

from service.api.context import Context
from service.api.server import create_app
from service.jobs.artifacts import artifact_name
from service.jobs.database import JOBS
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from tests.service.databases import lay_out
from tests.service.photo.badimages import picture, save
from tests.support.server import Server

TOY = "tests.support.toy_job"
TOY_PICTURE = "tests.support.toy_picture"
GOOD = save(picture(300, 280), "JPEG")


class Api:
    """The application in this process, without a worker."""

    def __init__(self, client: TestClient) -> None:
        self.client = client

    @property
    def context(self) -> Context:
        context: Context = self.client.app.state.context  # type: ignore[attr-defined]
        return context

    def post(
        self,
        photo: Any = GOOD,
        options: Any = None,
        *,
        name: str = "photo.jpg",
        kind: str = "image/jpeg",
        **headers: str,
    ) -> httpx2.Response:
        files: dict[str, Any] = {"image": (name, photo, kind)}
        if options is not None:
            text = options if isinstance(options, str) else json.dumps(options)
            files["options"] = (None, text, "application/json")
        sent = {key.replace("_", "-"): value for key, value in headers.items()}
        return self.client.post("/v1/avatars", files=files, headers=sent)

    def finished(self, archive: bytes) -> str:
        """A job that has succeeded, with this archive."""
        job: str = self.post().json()["id"]
        digest = hashlib.sha256(archive).hexdigest()
        name, copy = artifact_name(job, "archive", digest, "zip"), self.context.settings.data / "archive.zip"
        copy.write_bytes(archive)
        self.context.artifacts.put(copy, name)
        self.context.store.begin(f"{job}.1")
        facts = {"archive": name, "sha256": digest, "bytes": len(archive), "warnings": [], "timings": {}}
        assert self.context.store.succeed(job, facts | {"peak_rss_mb": 1.0}, 1e10)
        return job

    def ask(self, place: str, content: Any, **headers: str) -> httpx2.Response:
        """Ask for something of a finished avatar; ``content`` is JSON values, or what is sent as they are."""
        text = content if isinstance(content, str | bytes) else json.dumps(content)
        return self.client.post(place, content=text, headers={"Content-Type": "application/json", **headers})

    def work(self, kind: str, **settings: Any) -> None:
        """What a worker does with all jobs of a kind that wait, here."""
        chosen = dataclasses.replace(self.context.settings, **settings)
        runner = Runner(chosen, self.context.store, self.context.artifacts)
        for row in self.context.store.where(JOBS.c.kind == kind, JOBS.c.state == "queued"):
            assert runner.accept(row["workflow"])["kind"] == "wanted"
            runner.publish(row["id"], runner.make(row["id"]))
        runner.stop()

    def stored(self) -> list[Path]:
        """Files of uploads and jobs on the disk."""
        data = self.context.settings.data
        return [path for name in ("incoming", "artifacts") for path in (data / name).rglob("*") if path.is_file()]


def open_api(settings: Settings) -> TestClient:
    lay_out(settings.data)
    return TestClient(create_app(settings), base_url="http://localhost", raise_server_exceptions=False)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """One application for tests that leave nothing behind or do not mind what others left."""
    data = tmp_path_factory.mktemp("api") / "data"
    with open_api(Settings(data=data, program=TOY, reserve_mb=1)) as client:
        yield Api(client)


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A real server with a worker that runs the toy job, and short deadlines."""
    running = Server(
        tmp_path_factory.mktemp("server") / "data",
        {
            "header_seconds": 1.0, "idle_seconds": 1.0, "body_seconds": 5.0, "jobs": 2, "archive_program": TOY_PICTURE,
        },
    )  # fmt: skip
    running.start()
    yield running
    running.stop()


@pytest.fixture
def client(server: Server) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=server.url, timeout=20) as made:
        yield made


def is_problem(answer: httpx.Response | httpx2.Response, status: int, code: str) -> dict[str, Any]:
    """Check an answer against RFC 9457 and what it should say; returns the object."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body: dict[str, Any] = answer.json()
    assert body["code"] == code
    assert body["status"] == status
    assert {"type", "title", "detail"} <= set(body)
    for inside in ("Traceback", "site-packages", 'File "', "/incoming/", "/artifacts/"):
        assert inside not in answer.text
    return body
