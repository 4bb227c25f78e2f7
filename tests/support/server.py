"""A server of our own for measuring and testing it: started, asked, killed."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np

from service.jobs.process import descendants
from service.jobs.settings import PREFIX

TOY = "tests.support.toy_job"


def small_photo(seed: int, side: int = 256) -> bytes:
    """A JPEG that the decode gate accepts; other bytes for each seed. There is no face in it."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 255, (8, 8, 3), np.uint8)
    pixels = cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    return bytes(cv2.imencode(".jpg", pixels)[1])


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Server:
    """``avatarme serve`` as a process group of its own.

    Args:
        data: its data folder.
        settings: further settings by name.
        environment: further variables.
        with_worker: False for a server without a worker.
        within: makes of the command one that runs it within limits.
    """

    def __init__(
        self,
        data: Path,
        settings: dict[str, Any] | None = None,
        environment: dict[str, str] | None = None,
        *,
        with_worker: bool = True,
        within: Callable[[list[str]], list[str]] = list,
    ) -> None:
        self.data = data
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        usual = {"program": TOY, "reserve_mb": 1, "niceness": 0, "notice_seconds": 0.1, "look_seconds": 0.3}
        chosen = {"data": data, "port": self.port, **usual, **(settings or {})}
        self._environment = {**os.environ, **(environment or {})}
        self._environment |= {PREFIX + name.upper(): str(value) for name, value in chosen.items()}
        command = [sys.executable, "-m", "service", "serve", *(() if with_worker else ("--no-worker",))]
        self._command = within(command)
        self.log = data.with_name(data.name + ".log")
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, *, ready: bool = True, within: float = 180.0) -> None:
        """Start, and wait until it answers (``ready``: until it is ready).

        Raises:
            RuntimeError: it does not within the time.
        """
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                self._command, env=self._environment, stdout=log, stderr=log, start_new_session=True
            )
        self.wait("readyz" if ready else "livez", within)

    def wait(self, probe: str, within: float = 180.0) -> None:
        """Wait for a probe to say yes; for "readyz", with a worker too.

        Raises:
            RuntimeError: it does not within the time.
        """
        deadline = time.monotonic() + within
        while time.monotonic() < deadline:
            with contextlib.suppress(httpx.HTTPError):
                answer = httpx.get(f"{self.url}/{probe}", timeout=5)
                if answer.status_code == 200 and (probe != "readyz" or answer.json()["workers"] > 0):
                    return
            if self.process is None or self.process.poll() is not None:
                break
            time.sleep(0.05)
        status = None if self.process is None else self.process.poll()
        raise RuntimeError(f"the server is not ready (status {status}); see {self.log}")

    def processes(self) -> list[int]:
        """Process ids: the server first, then all that it started."""
        if self.process is None:
            return []
        return [self.process.pid, *descendants(self.process.pid)]

    def worker(self) -> int | None:
        """Process id of the worker."""
        for process in self.processes()[1:]:
            with contextlib.suppress(OSError):
                if b"service.jobs.worker" in Path(f"/proc/{process}/cmdline").read_bytes():
                    return process
        return None

    def kill(self) -> None:
        """SIGKILL to everything at once."""
        for process in self.processes():
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        if self.process is not None:
            self.process.wait()

    def stop(self, within: float = 45.0) -> int:
        """SIGTERM; returns the exit status.

        Raises:
            subprocess.TimeoutExpired: it takes longer.
        """
        if self.process is None:
            return 0
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(within)
        except subprocess.TimeoutExpired:
            self.kill()
            raise


def post(client: httpx.Client, photo: bytes, seed: int = 0, key: str | None = None, **options: Any) -> httpx.Response:
    """Post a photo."""
    headers = {"Idempotency-Key": key} if key is not None else {}
    files: Any = {
        "image": ("photo.jpg", photo, "image/jpeg"),
        "options": (None, json.dumps({"seed": seed, **options}), "application/json"),
    }
    return client.post("/v1/avatars", files=files, headers=headers)


def wait_for(client: httpx.Client, job: str, within: float = 60.0) -> dict[str, Any]:
    """State of a job when it has ended.

    Raises:
        TimeoutError: it does not within the time.
    """
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        state: dict[str, Any] = client.get(f"/v1/avatars/{job}").json()
        if state.get("state") not in ("queued", "running"):
            return state
        time.sleep(0.05)
    raise TimeoutError(f"job {job} is {state}")


def listed(client: httpx.Client) -> Iterator[str]:
    """Ids of all jobs that the service knows of."""
    address = "/v1/avatars?limit=100"
    while address:
        page = client.get(address).json()
        yield from (item["id"] for item in page["items"])
        address = f"/v1/avatars?limit=100&cursor={page['next']}" if page["next"] else ""


def in_threads(count: int, call: Any) -> list[Any]:
    """Call with 0 .. count - 1 in as many threads; returns the results in that order."""
    results: list[Any] = [None] * count

    def run(number: int) -> None:
        results[number] = call(number)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results
