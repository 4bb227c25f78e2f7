"""Processes of the service for tests, and waiting for what they do."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import IO, Any

from service.jobs.settings import Settings

WITHIN = 240.0


def start_worker(settings: Settings, point: str, stderr: IO[Any] | None = None) -> subprocess.Popen[bytes]:
    """A worker with a fault or a version, by ``tests.service.jobs.dying``; "" for neither."""
    command = [sys.executable, "-m", "tests.service.jobs.dying", "worker", point]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=stderr)
    assert process.stdin is not None
    process.stdin.write(settings.to_json().encode() + b"\n")
    process.stdin.close()
    return process


def wait_until(check: Callable[[], bool], within: float = WITHIN) -> None:
    """Return when ``check`` says yes, which it has to do in time."""
    deadline = time.monotonic() + within
    while not check():
        assert time.monotonic() < deadline
        time.sleep(0.05)
