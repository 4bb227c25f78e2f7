"""Death at every point where something has been written and something else has not."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from service.jobs.process import descendants
from tests.service.jobs.conftest import Bench, unfinished
from tests.service.jobs.processes import WITHIN, start_worker, wait_until
from tests.support.moments import redone
from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import LOG, archive

pytestmark = pytest.mark.slow

OF_A_WORKER = (
    "service.jobs.store:Store.begin:before",
    "service.jobs.store:Store.begin:after",
    "service.jobs.store:Store.progress:after",
    "service.jobs.workflow:Runner._store:before",  # the archive is written, and is not in its place
    "service.places:os.fsync:after",  # ... flushed, and not renamed
    "service.places:sync:before",  # ... renamed, and the folder is not flushed
    "service.jobs.artifacts:Artifacts.put:after",
    "service.jobs.store:Store.succeed:before",  # the step "make" is recorded
    "service.jobs.store:Store.succeed:after",  # the owner can see the end, and the queue does not know of it
    "service.jobs.artifacts:Artifacts.sweep:after",
    "service.jobs.store:Store.set:after",
)

OF_A_SERVER = (
    "service.jobs.artifacts:Artifacts.put:before",  # the photo has arrived and was looked through
    "service.places:os.fsync:after",
    "service.jobs.artifacts:Artifacts.put:after",  # the photo is on the disk, and nobody knows of it
    "service.jobs.queue:Queue.put:after",  # the job and its place in the queue are written, and not committed
    "service.jobs.store:Store.add:after",  # committed, and not answered
)


class Worker:
    """A worker process on the data of a bench."""

    def __init__(self, bench: Bench, point: str) -> None:
        self.process = start_worker(bench.settings, point)

    def died(self) -> bool:
        """Whether it reaches its point within the time."""
        try:
            return self.process.wait(WITHIN) == -signal.SIGKILL
        except subprocess.TimeoutExpired:
            return False
        finally:
            self.kill()

    def kill(self) -> None:
        for process in [*descendants(self.process.pid), self.process.pid]:
            if self.process.poll() is None:
                os.kill(process, signal.SIGKILL)
        self.process.wait()


def test_a_worker_may_die_at_every_point_of_a_job(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One job meets all of them, one after the other, and ends as if nothing had been."""
    log = tmp_path / "stages.log"
    monkeypatch.setenv(LOG, str(log))
    job = bench.add(seed=12)
    for point in OF_A_WORKER:
        assert Worker(bench, point).died(), point
    last = Worker(bench, "")
    try:
        wait_until(lambda: bench.row(job)["state"] == "succeeded" and unfinished(bench.queue) == [])
    finally:
        last.kill()
    row = bench.row(job)
    assert bench.artifacts.read(row["archive"]) == archive(row["photo_sha256"], 12)
    assert [name.split("/")[1].split("-")[0] for name in bench.artifacts.names(job)] == ["archive"]
    assert redone(log) == []
    states = [json.loads(event["body"])["state"] for event in bench.store.events(job, 0) if event["name"] == "state"]
    assert states[-1] == "succeeded"
    assert states.count("succeeded") == 1, "the end is told once"


def test_a_server_may_die_at_every_point_of_an_upload(tmp_path: Path) -> None:
    """Whoever gets no answer sends the same request again; there is one job, and it is a whole one."""
    photo, key, jobs = small_photo(1), "the same", set()
    server = Server(tmp_path / "data", with_worker=False)
    command = server._command
    for point in OF_A_SERVER:
        server._command = [sys.executable, "-m", "tests.service.jobs.processes", "server", point]
        server.start(ready=False)
        with httpx.Client(base_url=server.url, timeout=60) as client, pytest.raises(httpx.TransportError):
            post(client, photo, 5, key)
        assert server.process is not None
        assert server.process.wait(60) == -signal.SIGKILL, point
    server._command = [argument for argument in command if argument != "--no-worker"]
    server.start()
    with httpx.Client(base_url=server.url, timeout=60) as client:
        answer = post(client, photo, 5, key)
        assert answer.status_code == 202
        jobs = {item["id"] for item in client.get("/v1/avatars").json()["items"]}
        assert jobs == {answer.json()["id"]}
        assert wait_for(client, answer.json()["id"], within=WITHIN)["state"] == "succeeded"
        content = client.get(f"/v1/avatars/{answer.json()['id']}/archive.zip").content
    assert content == archive(hashlib.sha256(photo).hexdigest(), 5)
    server.stop()
