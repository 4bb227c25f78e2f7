"""Processes of the service for tests: they die by SIGKILL at a chosen point.

    python -m tests.service.jobs.processes worker POINT
    python -m tests.service.jobs.processes server POINT

POINT is ``module:Class.name:before`` (or ``after``): the process ends as soon as that function is called, or has
returned. A worker reads its settings from standard input, a server from the environment, as the real ones do.
"""

from __future__ import annotations

import functools
import importlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import IO, Any

from service.jobs.settings import Settings

WITHIN = 240.0


def start_worker(settings: Settings, point: str, stderr: IO[Any] | None = None) -> subprocess.Popen[bytes]:
    """A worker with a fault, by ``tests.service.jobs.processes``; "" for none."""
    command = [sys.executable, "-m", "tests.service.jobs.processes", "worker", point]
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


def die_at(point: str) -> None:
    """Put the end of this process into a function."""
    module, path, when = point.split(":")
    owner: Any = importlib.import_module(module)
    *parents, name = path.split(".")
    for parent in parents:
        owner = getattr(owner, parent)
    whole = getattr(owner, name)

    @functools.wraps(whole)
    def dying(*arguments: Any, **named: Any) -> Any:
        if when == "after":
            whole(*arguments, **named)
        os.kill(os.getpid(), signal.SIGKILL)

    setattr(owner, name, dying)


def main() -> int:
    """Become the one or the other."""
    _, role, point = sys.argv
    del sys.argv[1:]
    if point:
        die_at(point)
    if role == "worker":
        from service.jobs.worker import main as work

        return work()
    from service.api.server import serve
    from service.jobs.settings import from_environment

    serve(from_environment({}), with_worker=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
