"""Faults of the machine and of clients, with a whole server."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import SECONDS

pytestmark = pytest.mark.slow

WITHIN = 240.0


def enlarge_archive(server: Server, job: str, megabytes: int) -> None:
    """Put a large file in the place of a job's archive: what is in it does not matter here."""
    (path,) = (server.data / "artifacts" / job).glob("archive-*")
    with path.open("wb") as stream:
        for _ in range(megabytes):
            stream.write(bytes(1 << 20))
    with contextlib.closing(sqlite3.connect(server.data / "jobs.sqlite", timeout=60)) as database, database:
        database.execute("update avatarme_jobs set archive_bytes = ? where id = ?", (megabytes << 20, job))


class Servers:
    """Servers of one test; none outlives it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: list[Server] = []

    def make(
        self,
        settings: dict[str, Any] | None = None,
        environment: dict[str, str] | None = None,
        *,
        folder: Path | None = None,
        with_worker: bool = True,
    ) -> Server:
        """One that is not started yet."""
        data = (folder or self._folder) / "data"
        self._made.append(Server(data, settings, environment, with_worker=with_worker))
        return self._made[-1]

    def started(self, *arguments: Any, **named: Any) -> Server:
        """One that answers, and is ready if it has a worker."""
        server = self.make(*arguments, **named)
        server.start(ready=named.get("with_worker", True))
        return server

    def kill(self) -> None:
        for server in self._made:
            server.kill()


@pytest.fixture
def servers(tmp_path: Path) -> Iterator[Servers]:
    made = Servers(tmp_path)
    yield made
    made.kill()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 16 MB and 300 files."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=16m,nr_inodes=300", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("no file system can be mounted here (root only)")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def fill(place: Path) -> Callable[[], None]:
    """Use up all space; returns what gives it back."""
    path = place / "filler"
    with path.open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while stream.write(bytes(4096)):
            pass
    return path.unlink


def fill_names(place: Path) -> Callable[[], None]:
    """Use up all files; returns what gives them back."""
    folder = place / "names"
    folder.mkdir()
    for number in range(10_000):
        try:
            (folder / str(number)).touch()
        except OSError as error:
            assert error.errno == errno.ENOSPC
            break
    return lambda: shutil.rmtree(folder)


@pytest.mark.parametrize("use_up", [fill, fill_names])
def test_a_full_disk_takes_nothing_and_loses_nothing(
    servers: Servers, small_disk: Path, tmp_path: Path, use_up: Callable[[Path], Callable[[], None]]
) -> None:
    """No reserve here: space ends in the middle of whatever is going on, between the stages of a job too."""
    server = servers.make({"reserve_mb": 0}, {SECONDS: "2.0"}, folder=small_disk)
    server.log = tmp_path / "log"
    server.start()
    photo = small_photo(1)
    with httpx.Client(base_url=server.url, timeout=90) as client:
        job = post(client, photo, 2).json()["id"]
        while client.get(f"/v1/avatars/{job}").json()["state"] == "queued":
            time.sleep(0.05)
        free = use_up(small_disk)
        refused = post(client, small_photo(2), 2, "later")
        assert refused.status_code in (500, 503, 507), refused.text
        assert client.get("/livez").status_code == 200
        time.sleep(8)
        free()
        state = wait_for(client, job, within=WITHIN)
        # Either it waited, or it said that its result could not be stored; it is not lost.
        assert state["state"] == "succeeded" or state["error"]["code"] in ("output", "internal"), state
        again = post(client, small_photo(2), 2, "later")
        assert again.status_code == 202
        assert wait_for(client, again.json()["id"], within=WITHIN)["state"] == "succeeded"
    assert server.stop() == 0
    with contextlib.closing(sqlite3.connect(server.data / "jobs.sqlite")) as database:
        assert database.execute("pragma integrity_check").fetchone() == ("ok",)


def test_an_upload_under_way_is_finished_when_the_server_is_told_to_end(servers: Servers) -> None:
    server = servers.started(with_worker=False)
    photo = small_photo(1)
    with _upload(server, photo) as line:
        assert server.process is not None
        server.process.send_signal(signal.SIGTERM)
        time.sleep(1.0)
        assert server.process.poll() is None, "it did not wait for the upload"
        line.sendall(photo[1000:])
        assert line.recv(65536).startswith(b"HTTP/1.1 202")
    assert server.process.wait(45) == 0
    with contextlib.closing(sqlite3.connect(server.data / "jobs.sqlite")) as database:
        assert database.execute("select state from avatarme_jobs").fetchall() == [("queued",)]


def test_a_second_signal_ends_it_at_once(servers: Servers) -> None:
    server = servers.started({"body_seconds": 100, "idle_seconds": 100})
    processes = server.processes()
    with _upload(server, small_photo(1)):
        assert server.process is not None
        server.process.send_signal(signal.SIGTERM)
        time.sleep(1.0)
        begin = time.monotonic()
        server.process.send_signal(signal.SIGTERM)
        server.process.wait(20)
        assert time.monotonic() - begin < 15, "it would have waited 30 s for the upload"
    assert not [process for process in processes if Path(f"/proc/{process}/exe").exists()]


@contextlib.contextmanager
def _upload(server: Server, photo: bytes) -> Iterator[socket.socket]:
    """A connection on which the first thousand bytes of a photo have been sent."""
    head = "POST /v1/avatars HTTP/1.1\r\nHost: localhost\r\nContent-Type: image/jpeg\r\n"
    head += f"Content-Length: {len(photo)}\r\n\r\n"
    with socket.create_connection(("127.0.0.1", server.port), timeout=60) as line:
        line.sendall(head.encode() + photo[:1000])
        deadline = time.monotonic() + 30
        while not list((server.data / "incoming").glob("*")):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield line


@pytest.mark.parametrize("reader", ["gone", "asleep"])
def test_jobs_do_not_mind_a_log_that_nobody_reads(servers: Servers, tmp_path: Path, reader: str) -> None:
    server = servers.make()
    server.log = tmp_path / "pipe"
    os.mkfifo(server.log)
    end = os.open(server.log, os.O_RDONLY | os.O_NONBLOCK)
    server.start()
    if reader == "gone":
        os.close(end)
    with httpx.Client(base_url=server.url, timeout=60) as client:
        for number in range(400 if reader == "asleep" else 20):  # a pipe holds 64 KiB
            assert client.get("/v1/avatars", headers={"X-Request-Id": f"{number:0128d}"}).status_code == 200
        assert wait_for(client, post(client, small_photo(1)).json()["id"], within=WITHIN)["state"] == "succeeded"
    assert server.stop() == 0


def test_clients_that_leave_in_a_download_leave_nothing_behind(servers: Servers) -> None:
    server = servers.started()
    with httpx.Client(base_url=server.url, timeout=60) as client:
        job = post(client, small_photo(1)).json()["id"]
        wait_for(client, job, within=WITHIN)
        enlarge_archive(server, job, 32)
        address, process = f"/v1/avatars/{job}/archive.zip", server.processes()[0]
        before = len(os.listdir(f"/proc/{process}/fd"))
        for _ in range(20):
            with httpx.stream("GET", server.url + address, timeout=60) as answer:
                next(answer.iter_raw())
        deadline = time.monotonic() + 30
        while len(os.listdir(f"/proc/{process}/fd")) > before and time.monotonic() < deadline:
            time.sleep(0.1)
        assert len(os.listdir(f"/proc/{process}/fd")) <= before, "files or connections stay open"
        etag = client.head(address).headers["etag"]
        rest = client.get(address, headers={"Range": "bytes=1000000-", "If-Range": etag})
        assert rest.status_code == 206
        assert len(rest.content) == (32 << 20) - 1_000_000
    server.stop()
