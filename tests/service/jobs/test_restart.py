"""Killing, freezing and stopping a whole service."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

from benchmarks.chaos import chaos
from tests.service.jobs.test_webhooks import Dripping, Receiver
from tests.support.moments import redone
from tests.support.postgres import find_programs
from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import LOG, SECONDS, archive


def test_after_a_kill_the_job_goes_on_after_its_last_stage(tmp_path: Path) -> None:
    log = tmp_path / "log"
    server = Server(tmp_path / "data", {}, {LOG: str(log), SECONDS: "0.5"})
    server.start()
    photo = small_photo(1)
    with httpx.Client(base_url=server.url, timeout=30) as client:
        job = post(client, photo, 3).json()["id"]
        deadline = time.monotonic() + 60
        while not log.exists() or f"{job} kept one" not in log.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.02)
        processes = server.processes()
        server.kill()
        time.sleep(0.3)
        assert not [process for process in processes if _runs(process)], "a job's process outlived the server"
        server.start()
        assert wait_for(client, job)["state"] == "succeeded"
        content = client.get(f"/v1/avatars/{job}/archive.zip").content
    assert content == archive(hashlib.sha256(photo).hexdigest(), 3)
    assert redone(log) == []
    assert server.stop() == 0


@pytest.mark.slow
def test_a_signal_ends_it_and_the_job_goes_on_after_the_next_start(tmp_path: Path) -> None:
    server = Server(tmp_path / "data", {}, {SECONDS: "0.7"})
    server.start()
    with httpx.Client(base_url=server.url, timeout=30) as client:
        job = post(client, small_photo(1)).json()["id"]
        with client.stream("GET", f"/v1/avatars/{job}/events") as events:
            lines = events.iter_lines()
            while "running" not in next(lines):
                pass
            processes = server.processes()
            begin = time.monotonic()
            assert server.process is not None
            server.process.send_signal(signal.SIGTERM)
            assert "succeeded" not in "".join(lines), "the stream ends although the job has not"
        assert server.process.wait(45) == 0
        assert time.monotonic() - begin < 45
        assert not [process for process in processes if _runs(process)]
        server.start()
        assert wait_for(client, job)["state"] == "succeeded"
    server.stop()


@pytest.mark.slow
def test_a_worker_that_dies_is_started_again_and_http_stays(tmp_path: Path) -> None:
    server = Server(tmp_path / "data")
    server.start()
    with httpx.Client(base_url=server.url, timeout=30) as client:
        worker = server.worker()
        assert worker is not None
        os.kill(worker, signal.SIGKILL)
        assert client.get("/livez").status_code == 200
        assert wait_for(client, post(client, small_photo(1)).json()["id"])["state"] == "succeeded"
        assert server.worker() not in (None, worker)
    server.stop()


@pytest.mark.slow
def test_nothing_is_lost_in_a_little_chaos(tmp_path: Path) -> None:
    findings = chaos(tmp_path, 4)
    assert findings.well(), findings


@pytest.mark.slow
@pytest.mark.skipif(find_programs() is None, reason="Postgres is not installed")
def test_nothing_is_lost_with_several_workers_on_postgres(tmp_path: Path) -> None:
    findings = chaos(tmp_path, 8, posters=1, workers=3)
    assert findings.well(), findings


@pytest.mark.slow
def test_a_photo_becomes_the_same_archive_as_on_the_command_line(tmp_path: Path) -> None:
    """The pipeline itself behind the service, and the bytes that the service promises."""
    from service.diagnosis import SAMPLE

    options = '{"quality": "draft", "maps": ["texture", "confidence"]}'
    server = Server(tmp_path / "data", {"program": "service.jobs.avatar_process"})
    server.start()
    with httpx.Client(base_url=server.url, timeout=60) as client:
        files: Any = {"image": ("me.png", SAMPLE.read_bytes()), "options": (None, options)}
        job = client.post("/v1/avatars", files=files).json()["id"]
        state = wait_for(client, job, within=600)
        assert state["state"] == "succeeded", state
        served = client.get(f"/v1/avatars/{job}/archive.zip").content
        noise = client.post("/v1/avatars", files={"image": ("x", small_photo(5))}).json()["id"]
        refused = wait_for(client, noise, within=600)
    server.stop()
    assert refused["error"]["code"] == "no-face"
    assert refused["error"]["status"] == 422
    out = tmp_path / "out.zip"
    command = [sys.executable, "-m", "service", "make", str(SAMPLE), "-o", str(out), "--quality", "draft"]
    subprocess.run([*command, "--maps", "texture,confidence"], check=True, capture_output=True)
    assert served == out.read_bytes()


@pytest.mark.slow
def test_kept_stages_give_the_same_bytes(tmp_path: Path) -> None:
    """A run that finds all its stages kept, against one that computes them."""
    from io import BytesIO

    from service import pipeline
    from service.archive.pack import write_archive
    from service.diagnosis import SAMPLE
    from service.jobs.artifacts import Artifacts
    from service.jobs.avatar_process import options_from
    from service.jobs.stage_files import KeptStages, kept_types
    from service.stage_cache import NoCache

    (tmp_path / "scratch").mkdir()
    made: list[str] = []
    artifacts = Artifacts(f"file://{tmp_path}/artifacts")
    kept = KeptStages(artifacts, "0" * 32, "basis", kept_types(pipeline), tmp_path / "scratch", made.append)
    options = options_from({"quality": "draft", "size": [192, 128]})
    results = []
    for stages in (kept, kept, NoCache()):
        stream = BytesIO()
        write_archive(pipeline.make_avatar(SAMPLE.read_bytes(), options, stages=stages), stream)
        results.append(stream.getvalue())
    assert results[0] == results[1] == results[2]
    assert len(made) == len(set(made)) >= 5, "the second run computed a stage again"


def _runs(process: int) -> bool:
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def test_data_are_for_the_owner_of_the_server_only(tmp_path: Path) -> None:
    """Whatever the umask, and whatever an older version or a careless hand has left."""
    data = tmp_path / "data"
    (data / "artifacts").mkdir(parents=True, mode=0o755)
    (data / "first-key.txt").write_text("a key")
    (data / "first-key.txt").chmod(0o644)
    before = os.umask(0)
    server = Server(data)
    try:
        server.start()
    finally:
        os.umask(before)
    with httpx.Client(base_url=server.url, timeout=30) as client:
        job = post(client, small_photo(1)).json()["id"]
        assert wait_for(client, job)["state"] == "succeeded"
        found = {path.relative_to(data): path.stat().st_mode for path in [data, *data.rglob("*")]}
    assert {"jobs.sqlite", "jobs.sqlite-wal", "first-key.txt", "server.lock"} <= {path.name for path in found}
    assert {path: oct(mode) for path, mode in found.items() if mode & 0o077} == {}
    assert server.stop() == 0


def test_a_receiver_that_never_answers_keeps_nobody_elses_messages(tmp_path: Path) -> None:
    """Two tenants at one server, whose receivers are at two hosts: the one that drips has a deadline and a place."""
    keys = {name: f"key-of-{name}-{'x' * 40}" for name in ("ada", "bob")}
    entries = [{"name": name, "sha256": hashlib.sha256(key.encode()).hexdigest()} for name, key in keys.items()]
    (tmp_path / "keys.json").write_text(json.dumps({"keys": entries}))
    (tmp_path / "secret").write_bytes(b"a secret")
    slow, good = Dripping(), Receiver()
    hosts = f"127.0.0.1:{slow.port},localhost:{good.server.server_port}"
    settings = {
        "keys": tmp_path / "keys.json", "webhook_hosts": hosts, "webhook_secret": tmp_path / "secret",
        "webhook_private": True,
    }  # fmt: skip
    server = Server(tmp_path / "data", settings)
    server.start()
    try:
        with httpx.Client(base_url=server.url, timeout=30) as client:

            def send(name: str, seed: int, address: str) -> str:
                client.headers["Authorization"] = f"Bearer {keys[name]}"
                files: Any = {"image": ("x.jpg", small_photo(seed)), "webhook_url": (None, address)}
                answer = client.post("/v1/avatars", files=files)
                assert answer.status_code == 202, answer.text
                return str(answer.json()["id"])

            for seed in range(20):
                send("ada", seed, f"http://127.0.0.1:{slow.port}/{seed}")
            jobs = [send("bob", 100 + seed, good.url) for seed in range(3)]
            assert all(wait_for(client, job)["state"] == "succeeded" for job in jobs)
            ended = time.monotonic()
            while len(good.seen) < len(jobs):
                assert time.monotonic() < ended + 15
                time.sleep(0.05)
        assert {json.loads(body)["job"]["id"] for _, body in good.seen} == set(jobs)
        assert slow.taken >= 1
    finally:
        server.stop()
        good.server.shutdown()
        good.server.server_close()
        slow.listener.close()
