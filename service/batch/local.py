"""Archives made on this machine, each in a process of its own that ends with its photo.

So memory stays flat over any number of photos, a crash in native code costs one photo, and a photo that never ends can
be stopped.
"""

from __future__ import annotations

import contextlib
import secrets
import shutil
import signal
import threading
from pathlib import Path
from typing import Any

from service.batch.child import HEAD, LOG
from service.batch.maker import Hopeless, Order, Progress, Stopped
from service.client.download import check_archive
from service.errors import AvatarError, Crashed, OutOfMemory, OutOfTime, OutputFault
from service.jobs.process import Ending, JobProcess, Task
from service.jobs.settings import Settings

_TAIL = 2000


class LocalMaker:
    """Runs the pipeline in processes.

    Args:
        work: folder for files on their way, on the file system of the archives.
        head: head model file, None for the one in the box.
        timeout_s: longest time of one photo.
        program: module that makes a photo; tests put a small one here.
    """

    def __init__(self, work: Path, *, head: str | None, timeout_s: float, program: str = "service.batch.child") -> None:
        self._work = work
        self._head = head
        self._settings = Settings(program=program, job_seconds=timeout_s, niceness=0)
        self._stopped = threading.Event()
        for left in work.iterdir():  # of a run that was killed
            shutil.rmtree(left, ignore_errors=True)

    def make(self, order: Order, progress: Progress) -> list[str]:
        """See ``Maker.make``."""
        scratch = self._work / secrets.token_hex(8)
        scratch.mkdir()
        try:
            ending, started = self._run(order, scratch, progress)
            if ending.kind == "stopped":
                raise Stopped
            if ending.kind == "crash" and not started:
                raise Hopeless(Crashed("the process that makes a photo cannot start; 'avatarme doctor' may say why"))
            if ending.kind != "done":
                raise self._fault(ending, scratch)
            archive = scratch / "archive.zip"
            check_archive(archive)
            archive.replace(order.target)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
        return [str(code) for code in ending.facts.get("warnings", [])]

    def stop(self) -> None:
        """See ``Maker.stop``."""
        self._stopped.set()

    def close(self) -> None:
        """See ``Maker.close``."""
        shutil.rmtree(self._work, ignore_errors=True)

    def _run(self, order: Order, scratch: Path, progress: Progress) -> tuple[Ending, bool]:
        """How the process ended, and whether it had come as far as asking for its task."""
        task = Task(
            job=order.sha256,
            photo=str(order.photo.absolute()),
            photo_sha256=order.sha256,
            options={**order.options, HEAD: self._head},
            artifacts="",
            output=str((scratch / "archive.zip").absolute()),
            scratch=str(scratch.absolute()),
        )

        started = threading.Event()

        def told(message: dict[str, object]) -> None:
            if "ready" in message:
                started.set()
            stage, share = message.get("stage"), message.get("share")
            if isinstance(stage, str) and isinstance(share, int | float):
                progress(stage, float(share))

        return JobProcess(self._settings).run(task, told, self._stopped.is_set), started.is_set()

    def _fault(self, ending: Ending, scratch: Path) -> AvatarError:
        limits = self._settings
        if ending.kind == "problem":
            fault = _reported(ending.facts)
            return OutputFault(fault.message) if fault.reported_code == OutputFault.code else fault
        if ending.kind == "time":
            return OutOfTime(f"not done after {limits.job_seconds:g} s; --timeout allows more")
        if ending.kind == "memory":
            return OutOfMemory(f"it needs more than {limits.memory_mb} MiB of memory, or than this machine has")
        how = f"exit status {ending.status}"
        if ending.status < 0:
            with contextlib.suppress(ValueError):
                how = signal.Signals(-ending.status).name
        return Crashed(f"the process that made it ended with {how}", log=_tail(scratch / LOG))


class Reported(AvatarError):
    """A fault that the process named; ``reported_code`` is the code of its class over there."""

    code = "reported"

    def __init__(self, message: str, *, reported_code: str = "internal", **extra: Any) -> None:
        super().__init__(message, **extra)
        self.reported_code = reported_code


def _reported(facts: dict[str, Any]) -> Reported:
    extra = {str(name): value for name, value in facts.items() if name not in ("code", "message", "reported_code")}
    message = str(facts.get("message", "the process failed without words"))
    return Reported(message, reported_code=str(facts.get("code", "internal")), **extra)


def _tail(log: Path) -> str:
    with contextlib.suppress(OSError), log.open("rb") as stream:
        stream.seek(max(0, log.stat().st_size - _TAIL))
        return stream.read().decode("utf-8", "replace")
    return ""
