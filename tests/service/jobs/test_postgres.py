"""Several workers on one Postgres; one of them behind a bad line."""

from __future__ import annotations

import hashlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.jobs.settings import Settings
from tests.service.jobs.conftest import unfinished
from tests.service.jobs.processes import WITHIN, wait_until
from tests.service.jobs.s3 import S3, serve
from tests.support.moments import redone
from tests.support.postgres import Postgres, find_programs
from tests.support.server import TOY, Server, post, small_photo, wait_for
from tests.support.slow_line import Line
from tests.support.toy_job import LOG, archive
from tests.support.workers import Workers

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_programs() is None, reason="Postgres is not installed (apt-get install postgresql)"),
]


class Site:
    """A Postgres, a server without a worker, and how both are reached."""

    def __init__(self, folder: Path, artifacts: str = "") -> None:
        self.folder = folder
        self.postgres = Postgres(folder)
        self.postgres.start()
        self.settings: dict[str, Any] = {
            "database": self.postgres.url, "artifacts": artifacts or f"file://{folder}/artifacts", "program": TOY,
            "reserve_mb": 1, "niceness": 0,
        }  # fmt: skip
        self.server = Server(folder / "server", self.settings, with_worker=False)
        self.server.start(ready=False)
        self.client = httpx.Client(base_url=self.server.url, timeout=60)

    def state(self, job: str) -> str:
        return str(self.client.get(f"/v1/avatars/{job}").json()["state"])

    def unfinished(self) -> list[str]:
        """Workflows of jobs that wait or run."""
        from service.jobs.database import connect
        from service.jobs.queue import Queue

        engine = connect(Settings(data=self.folder, **self.settings).database_url)
        queue = Queue(engine)
        try:
            return [status.workflow_id for status in unfinished(queue)]
        finally:
            queue.client.destroy()
            engine.dispose()

    def ends(self, job: str, seed: int, photo: bytes) -> None:
        """It succeeds, once, with the bytes of an undisturbed run."""
        assert wait_for(self.client, job, within=WITHIN)["state"] == "succeeded"
        content = self.client.get(f"/v1/avatars/{job}/archive.zip").content
        assert content == archive(hashlib.sha256(photo).hexdigest(), seed)
        told = self.client.get(f"/v1/avatars/{job}/events").text
        assert told.count('"state": "succeeded"') == 1, "the end is told once"

    def close(self) -> None:
        self.client.close()
        self.server.kill()
        self.postgres.stop("immediate")


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    made = Site(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize("forget", [True, False])
def test_a_slow_line_and_a_split_network_cost_time_only(
    site: Site, monkeypatch: pytest.MonkeyPatch, forget: bool
) -> None:
    """The one worker that has jobs is far away, then out of reach for half a minute with a job in its hands."""
    line = Line(site.postgres.port)
    far = {"database": site.postgres.url_by(line.port), "jobs": 2}
    workers = Workers(site.folder, site.settings, [], {"far": far})
    photo = small_photo(1)
    try:
        workers.start("far")
        site.server.wait("readyz")
        line.delay = 0.05
        first = post(site.client, photo, 1).json()["id"]
        site.ends(first, 1, photo)
        jobs = {seed: post(site.client, photo, seed).json()["id"] for seed in (2, 3)}
        wait_until(lambda: site.state(jobs[2]) == "running")
        line.delay = 2.0
        time.sleep(5)
        line.split()
        workers.start("near")
        jobs[4] = post(site.client, photo, 4).json()["id"]
        site.ends(jobs[4], 4, photo)  # the others go on meanwhile
        time.sleep(25)
        line.delay = 0.0
        line.mend(forget=forget)
        for _ in range(60):
            if workers.running["far"].poll() is not None:
                workers.start("far")  # as a supervisor does
            if all(site.state(job) == "succeeded" for job in jobs.values()):
                break
            time.sleep(1)
        for seed, job in jobs.items():
            site.ends(job, seed, photo)
        wait_until(lambda: site.unfinished() == [], 60)
    finally:
        line.close()
        workers.stop()


@pytest.fixture
def s3(tmp_path: Path) -> Iterator[S3]:
    yield from serve()


def test_a_job_goes_on_with_another_worker_and_what_lies_on_a_store(
    s3: S3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The two have a bucket and Postgres in common and nothing else; the one is killed in the second stage."""
    log = tmp_path / "stages.log"
    site = Site(tmp_path, "s3://bucket/avatars")
    monkeypatch.setenv(LOG, str(log))
    workers = Workers(site.folder, site.settings, ["one"])
    photo = small_photo(1)
    try:
        site.server.wait("readyz")
        job = post(site.client, photo, 1).json()["id"]
        wait_until(lambda: log.exists() and f"{job} begin two" in log.read_text())
        workers.signal("one", signal.SIGKILL)
        workers.start("two")
        site.ends(job, 1, photo)
        assert redone(log) == []
        assert site.client.delete(f"/v1/avatars/{job}").status_code == 204
    finally:
        workers.stop()
        site.close()
