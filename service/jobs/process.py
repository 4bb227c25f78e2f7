"""The process of one job: starting, watching and ending it, the limits that it sets itself, and the lines of JSON that
both sides exchange; and what else a process of the server arranges with its system.

DBOS runs a step in a thread of its worker, where a decoder that crashes, runs out of memory or never ends would take
all other jobs along.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import logging
import os
import queue
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.errors import AvatarError, Crashed, OutOfMemory, OutOfTime, as_facts
from service.machine import kib
from service.photo.wire import lower_limits

if TYPE_CHECKING:  # the process itself is told what it needs, and does without pydantic
    from service.jobs.settings import Settings

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Task:
    """One job, as its process gets it.

    Attributes:
        job: its id.
        photo: path of the photo on this machine.
        photo_sha256: hex digest that the photo has to have.
        options: JSON values of ``service.options.Options``.
        artifacts: fsspec URL of the store, for finished stages, in the folder ``stages``; "" for the job's own.
        output: path to write the archive to.
        scratch: folder for files on their way.
        tight: get by with less memory than usual; an attempt before this one ran out of it.
    """

    job: str
    photo: str
    photo_sha256: str
    options: Mapping[str, Any]
    artifacts: str
    output: str
    scratch: str
    tight: bool = False
    stages: str = ""


class Reporter:
    """Lines from the process to the one that started it.

    Takes over the standard output: what a library prints goes to standard error instead.
    """

    def __init__(self) -> None:
        self._stream = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=0)
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def ready(self) -> None:
        """The program is loaded."""
        self._say({"ready": True})

    def progress(self, stage: str, share: float) -> None:
        """A stage begins; ``share`` of the work is done."""
        self._say({"stage": stage, "share": share})

    def kept(self, stage: str) -> None:
        """A stage is computed and its result is on the disk."""
        self._say({"kept": stage})

    def done(self, facts: Mapping[str, Any]) -> None:
        """The archive is written."""
        self._say({"done": facts})

    def problem(self, error: Exception) -> None:
        """There will be no archive; a fault that is not the photo's is logged with its traceback."""
        from service.runtime.sessions import lacked_memory

        if isinstance(error, OutOfMemory) or lacked_memory(error):
            error = OutOfMemory("the computation needs more memory than this server allows")
        elif not isinstance(error, AvatarError) or error.http_status >= 500:
            log.error("the job failed", exc_info=error)
        self._say({"problem": as_facts(error)})

    def _say(self, message: Mapping[str, Any]) -> None:
        self._stream.write(json.dumps(message).encode() + b"\n")


def main() -> int:
    """A job's process: limits first, then loading its program, then one task.

    The program is a module with a function ``run(task, reporter)`` that computes a job and says ``done``; a fault
    leaves it as an exception. What it needs it imports at its top, which is done before there is a task.
    """
    memory, seconds, niceness, parent = (float(text) for text in sys.argv[2:6])
    reporter = Reporter()
    limit_self(int(memory), seconds, int(niceness), int(parent))
    program = importlib.import_module(sys.argv[1])
    gc.freeze()  # nothing that the libraries made is garbage
    reporter.ready()
    line = sys.stdin.buffer.readline()
    if not line:
        return 0
    task = Task(**json.loads(line))
    try:
        program.run(task, reporter)
    except Exception as error:  # whatever it is, the job has to end with an answer
        reporter.problem(error)
    return 0


_PR_SET_PDEATHSIG = 1
_OOM_SCORE = "500"
_LARGE = 1 << 20


def limit_self(memory_mb: int, seconds: float, niceness: int, parent: int) -> None:
    """Apply the limits; the process ends with its ``parent``.

    ``memory_mb`` is the most private writable memory in MiB, 0 for no limit; an allocation beyond it raises
    MemoryError. ``seconds`` of processor time per core are the system's to end the process after, in case that nobody
    else does.
    """
    with contextlib.suppress(OSError):
        os.nice(niceness)
    lower_limits(CORE=0, CPU=int(seconds * (os.cpu_count() or 1)) + 60)
    if memory_mb:
        # RLIMIT_AS would count the address space that allocators and networks reserve and never use.
        lower_limits(DATA=memory_mb << 20)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as score:
        score.write(_OOM_SCORE)  # the system takes this process first, not the server
    end_with_parent(parent)


def end_with_parent(parent: int) -> None:
    """Have the system end this process together with the one that started it."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the line above
        os._exit(1)


def keep_private(folder: Path) -> None:
    """Let nobody but this process's user read what it writes from now on, nor what lies in a folder, which it makes."""
    os.umask(0o077)
    folder.mkdir(parents=True, exist_ok=True)
    for place, _, files in os.walk(folder):
        for path in (Path(place), *(Path(place, name) for name in files)):
            with contextlib.suppress(OSError):  # somebody else's, or gone meanwhile
                mode = path.lstat().st_mode
                if mode & 0o077 and not stat.S_ISLNK(mode):
                    path.chmod(stat.S_IMODE(mode) & 0o700)


def give_back_memory() -> None:
    """Have large blocks returned to the system as soon as they are free.

    glibc would raise the size from which it does so with every photo that passes through, and then keep what was freed,
    in a heap of its own for each thread.
    """
    from service.runtime.sessions import GLIBC, MMAP_THRESHOLD

    GLIBC.mallopt(MMAP_THRESHOLD, _LARGE)


TICK, WEIGHED = 0.2, 1.0
"""Seconds between two looks at cancellation and time, and at memory, which the system limits by itself."""


class Glance:
    """A question that is asked every ``seconds`` at most; once it is True it stays so."""

    def __init__(self, question: Callable[[], bool], seconds: float) -> None:
        self._question, self._seconds = question, seconds
        self._next, self._answer = 0.0, False

    def __call__(self) -> bool:
        """The answer, or the last one."""
        if not self._answer and time.monotonic() >= self._next:
            self._answer = self._question()
            self._next = time.monotonic() + self._seconds
        return self._answer


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

    @property
    def starved(self) -> bool:
        """Whether memory lacked."""
        return self.kind == "memory" or self.facts.get("code") == OutOfMemory.code

    def fault(self, limits: Settings) -> AvatarError:
        """What became of the photo, where the process has not said so itself."""
        if self.kind == "time":
            return OutOfTime(f"the computation took more than {limits.job_seconds:g} s")
        if self.starved and self.status < 0:
            return OutOfMemory("the system ended the computation, as it does where the machine runs out of memory")
        if self.starved:
            return OutOfMemory(f"the computation needs more than the {limits.memory_mb} MiB that it may have")
        how = f"exit status {self.status}"
        if self.status < 0:
            with contextlib.suppress(ValueError):
                how = signal.Signals(-self.status).name
        return Crashed(f"the computation ended with {how}")


class JobProcess:
    """A process that loads the program, waits for one task, and ends after it.

    It has a process group of its own, so that its end is the end of all that it started. Its standard error goes to the
    file ``noise``, or to this process's own.
    """

    def __init__(self, settings: Settings, noise: Path | None = None) -> None:
        limits = (settings.memory_mb, settings.job_seconds, settings.niceness, os.getpid())
        self._settings = settings
        command = [sys.executable, "-m", "service.jobs.process", settings.program, *map(str, limits)]
        environment = {"OPENBLAS_NUM_THREADS": "1", **os.environ}  # as the command line does
        with contextlib.ExitStack() as opened:
            stderr = None if noise is None else opened.enter_context(noise.open("wb"))
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and our own module, no shell
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, start_new_session=True,
                env=environment,
            )  # fmt: skip

    def run(self, task: Task, progress: Callable[[dict[str, Any]], None], stop: Callable[[], bool]) -> Ending:
        """Hand over a task and wait for its end.

        ``progress`` is called with each line that is neither "done" nor "problem"; ``stop`` is asked every ``TICK``,
        and True ends the process.
        """
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.write(json.dumps(asdict(task)).encode() + b"\n")
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
        too_large = Glance(self._too_large, WEIGHED)
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
            if too_large():
                return Ending("memory", {}, 0)

    def _explain(self, answer: dict[str, Any] | None) -> Ending:
        status = self._process.wait()
        if answer is not None and status == 0:
            kind = "done" if "done" in answer else "problem"
            return Ending(kind, dict(answer[kind]), status)
        # Nobody here killed it, so the system did: it ran out of memory.
        return Ending("memory" if status == -signal.SIGKILL else "crash", {}, status)

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
        processes = [self._process.pid, *descendants(self._process.pid)]
        return 0 < self._settings.memory_mb < sum(map(resident_mb, processes))


def descendants(process: int) -> list[int]:
    """Processes that a process started, and those that these started."""
    found: list[int] = []
    with contextlib.suppress(OSError, ValueError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            for child in map(int, (thread / "children").read_text("ascii").split()):
                found += [child, *descendants(child)]
    return found


def resident_mb(process: int) -> float:
    """Resident memory of a process that is its own, in MiB; 0 where it is gone."""
    return (kib(Path(f"/proc/{process}/status"), "RssAnon") or 0) / 1024


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    os._exit(status)  # what the libraries hold need not be torn down
