"""Starting, watching and ending the process of one job."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.jobs.settings import Settings
from service.jobs.wire import Task

log = logging.getLogger(__name__)

TICK = 0.2
"""Seconds between two looks at cancellation, time and memory."""

_END_OF_MEMORY = (-signal.SIGKILL,)


@dataclass(frozen=True)
class Ending:
    """How a job's process ended.

    Attributes:
        kind: "done", "problem", "stopped" (somebody wanted it to end), "time", "memory" or "crash".
        facts: what it said with "done" or "problem".
        status: exit status, negative for a signal.
    """

    kind: str
    facts: dict[str, Any]
    status: int


class JobProcess:
    """A process that loads the program, waits for one task, and ends after it.

    It has a process group of its own, so that its end is the end of all that it started.
    """

    def __init__(self, settings: Settings) -> None:
        limits = (settings.memory_mb, settings.job_seconds, settings.niceness, os.getpid())
        self._settings = settings
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and our own module, no shell
            [sys.executable, "-m", settings.program, *(str(limit) for limit in limits)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )

    def run(self, task: Task, progress: Callable[[dict[str, Any]], None], stop: Callable[[], bool]) -> Ending:
        """Hand over a task and wait for its end.

        Args:
            task: the job.
            progress: called with each line that is neither "done" nor "problem".
            stop: asked every ``TICK``; True ends the process.
        """
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.write(task.line())
                self._process.stdin.flush()
        lines: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, args=(lines,), daemon=True).start()
        deadline = time.monotonic() + self._settings.job_seconds
        try:
            return self._watch(lines, progress, stop, deadline)
        finally:
            self.end()

    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def end(self) -> None:
        """Kill the process and everything it started, and collect it."""
        for process in [*descendants(self._process.pid), self._process.pid]:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        with contextlib.suppress(OSError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()

    def _watch(
        self,
        lines: queue.SimpleQueue[dict[str, Any] | None],
        progress: Callable[[dict[str, Any]], None],
        stop: Callable[[], bool],
        deadline: float,
    ) -> Ending:
        answer: dict[str, Any] | None = None
        while True:
            with contextlib.suppress(queue.Empty):
                message = lines.get(timeout=TICK)
                if message is None:
                    return self._explain(answer)
                if "done" in message or "problem" in message:
                    answer = message
                else:
                    progress(message)
            if stop():
                return Ending("stopped", {}, 0)
            if time.monotonic() > deadline:
                return Ending("time", {}, 0)
            if self._too_large():
                return Ending("memory", {}, 0)

    def _explain(self, answer: dict[str, Any] | None) -> Ending:
        status = self._process.wait()
        if answer is not None and status == 0:
            kind = "done" if "done" in answer else "problem"
            return Ending(kind, dict(answer[kind]), status)
        # Nobody here killed it, so the system did: it ran out of memory.
        return Ending("memory" if status in _END_OF_MEMORY else "crash", {}, status)

    def _read(self, lines: queue.SimpleQueue[dict[str, Any] | None]) -> None:
        pipe = self._process.stdout
        with contextlib.suppress(OSError, ValueError):
            for line in pipe or ():
                try:
                    message = json.loads(line)
                except ValueError:
                    continue
                if isinstance(message, dict):
                    lines.put(message)
        lines.put(None)

    def _too_large(self) -> bool:
        limit = self._settings.memory_mb
        if not limit or sys.platform != "linux":
            return False
        processes = [self._process.pid, *descendants(self._process.pid)]
        return sum(resident_mb(process) for process in processes) > limit


def descendants(process: int) -> list[int]:
    """Processes that a process started, and those that these started; empty where the system has no /proc."""
    return list(_descend(process)) if sys.platform == "linux" else []


def _descend(process: int) -> Iterator[int]:
    with contextlib.suppress(OSError, ValueError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            for child in (thread / "children").read_text("ascii").split():
                yield int(child)
                yield from _descend(int(child))


def resident_mb(process: int) -> float:
    """Resident memory of a process that is its own, in MiB; 0 where it is gone."""
    with contextlib.suppress(OSError, ValueError, StopIteration), open(f"/proc/{process}/status", "rb") as status:
        return next(int(line.split()[1]) for line in status if line.startswith(b"RssAnon")) / 1024
    return 0.0
