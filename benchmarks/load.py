"""What the service bears while its workers compute.

    python -m benchmarks.load

Status requests at a rate, parallel uploads, many queued jobs listed in pages, downloads at the same time; each with
times and the memory of the HTTP process. Jobs are those of ``tests.support.toy_job``; their processes keep a core busy.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from service.jobs.process import resident_mb
from tests.support.server import Server, in_threads, post, small_photo, wait_for
from tests.support.toy_job import BUSY, SECONDS


class Peak:
    """Largest resident memory of a process while it is watched."""

    def __init__(self, process: int) -> None:
        self._process = process
        self._over = threading.Event()
        self.begin = self.peak = resident_mb(process)
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(0.05):
            self.peak = max(self.peak, resident_mb(self._process))

    def stop(self) -> dict[str, float]:
        """``begin_mb`` and ``peak_mb``."""
        self._over.set()
        self._thread.join()
        return {"begin_mb": round(self.begin, 1), "peak_mb": round(self.peak, 1)}


def percentiles(seconds: Sequence[float]) -> dict[str, float]:
    """Median, 99th percentile and maximum in milliseconds."""
    values = np.asarray(seconds) * 1000
    return {
        "median_ms": round(float(np.median(values)), 1),
        "p99_ms": round(float(np.percentile(values, 99)), 1),
        "max_ms": round(float(values.max()), 1),
    }


async def status_requests(url: str, job: str, rate: float, seconds: float, lines: int = 8) -> dict[str, Any]:
    """Ask for the state of a job at a rate over a few kept connections; times count from when each was due."""
    times: list[float] = []
    failures = 0

    async def client(number: int) -> None:
        nonlocal failures
        reader, writer = await asyncio.open_connection(*_address(url))
        request = f"GET /v1/avatars/{job} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
        begin = time.perf_counter() + number / rate
        for count in range(int(rate * seconds / lines)):
            due = begin + count * lines / rate
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            writer.write(request)
            head = await reader.readuntil(b"\r\n\r\n")
            length = int(head.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
            await reader.readexactly(length)
            times.append(time.perf_counter() - due)
            failures += not head.startswith(b"HTTP/1.1 200")
        writer.close()

    begin = time.perf_counter()
    await asyncio.gather(*(client(number) for number in range(lines)))
    passed = time.perf_counter() - begin
    return {"requests": len(times), "per_s": round(len(times) / passed, 1), "failures": failures, **percentiles(times)}


def uploads(server: Server, count: int, megabytes: int) -> dict[str, Any]:
    """Post large photos at the same time."""
    photo = _large_photo(megabytes)
    process = server.processes()[0]
    peak = Peak(process)

    def one(number: int) -> tuple[int, float]:
        begin = time.perf_counter()
        with httpx.Client(base_url=server.url, timeout=300) as client:
            status = post(client, photo, number % 100).status_code
        return status, time.perf_counter() - begin

    results = in_threads(count, one)
    statuses = [status for status, _ in results]
    return {
        "uploads": count,
        "megabytes": round(len(photo) / 2**20, 1),
        "accepted": statuses.count(202),
        **percentiles([seconds for _, seconds in results]),
        **peak.stop(),
    }


def queue(server: Server, count: int) -> dict[str, Any]:
    """Put many jobs into the queue and list them in pages."""
    times, pages, seen = [], [], set()
    with httpx.Client(base_url=server.url, timeout=60) as client:
        photo = small_photo(7)
        for number in range(count):
            begin = time.perf_counter()
            if post(client, photo, number % 100).status_code == 202:
                times.append(time.perf_counter() - begin)
        cursor: str | None = ""
        while cursor is not None:
            begin = time.perf_counter()
            page = client.get(f"/v1/avatars?limit=100{f'&cursor={cursor}' if cursor else ''}").json()
            pages.append(time.perf_counter() - begin)
            seen |= {item["id"] for item in page["items"]}
            cursor = page["next"]
    return {"posted": len(times), "post": percentiles(times), "listed": len(seen), "page": percentiles(pages)}


def downloads(server: Server, job: str, count: int) -> dict[str, Any]:
    """Fetch an archive many times at the same time."""
    peak = Peak(server.processes()[0])

    def one(number: int) -> tuple[int, float]:
        begin, size = time.perf_counter(), 0
        with httpx.stream("GET", f"{server.url}/v1/avatars/{job}/archive.zip", timeout=300) as answer:
            for block in answer.iter_raw():
                size += len(block)
        return size, time.perf_counter() - begin

    results = in_threads(count, one)
    sizes = {size for size, _ in results}
    return {"downloads": count, "bytes_each": sorted(sizes), **percentiles([s for _, s in results]), **peak.stop()}


@contextlib.contextmanager
def running(folder: Path, **settings: Any) -> Iterator[Server]:
    """A server that is ready."""
    server = Server(
        folder / "data",
        {"max_unfinished": 100_000, "max_queued": 100_000, "niceness": 10, **settings},
        {SECONDS: "0.5", BUSY: "1"},
    )
    server.start()
    try:
        yield server
    finally:
        server.kill()


def _large_photo(megabytes: int) -> bytes:
    """A JPEG of about so many bytes, most of them behind its end, where the gate does not look."""
    photo = small_photo(3, side=512)
    return photo + bytes(max(0, (megabytes << 20) - len(photo)))


def _address(url: str) -> tuple[str, int]:
    host, _, port = url.removeprefix("http://").partition(":")
    return host, int(port)


def _large_archive(server: Server, job: str, megabytes: int) -> None:
    """Put a large file in the place of a job's archive: what is in it does not matter here."""
    import sqlite3

    (path,) = (server.data / "artifacts" / job).glob("archive-*")
    with path.open("wb") as stream:
        for _ in range(megabytes):
            stream.write(bytes(1 << 20))
    with contextlib.closing(sqlite3.connect(server.data / "jobs.sqlite", timeout=60)) as database, database:
        database.execute("update avatarme_jobs set archive_bytes = ? where id = ?", (megabytes << 20, job))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=500)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--uploads", type=int, default=50)
    parser.add_argument("--queued", type=int, default=1000)
    parser.add_argument("--downloads", type=int, default=20)
    asked = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="load-"))
    with running(folder) as server, httpx.Client(base_url=server.url, timeout=60) as client:
        job = post(client, small_photo(1)).json()["id"]
        wait_for(client, job, within=300)
        _print("status", asyncio.run(status_requests(server.url, job, asked.rate, asked.seconds)))
        _large_archive(server, job, 200)
        _print("downloads", downloads(server, job, asked.downloads))
        _print("uploads", uploads(server, asked.uploads, 20))
        _print("queue", queue(server, asked.queued))
        _print("status with a queue", asyncio.run(status_requests(server.url, job, asked.rate, asked.seconds)))
        _print("memory of the HTTP process", {"mb": round(resident_mb(server.processes()[0]), 1)})
    shutil.rmtree(folder)


def _print(name: str, found: dict[str, Any]) -> None:
    print(json.dumps({name: found}), flush=True)


if __name__ == "__main__":
    main()
