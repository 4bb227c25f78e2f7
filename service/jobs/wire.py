"""What a job's process and the one that started it tell each other: JSON, one object a line."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, BinaryIO

ARGUMENTS = 4
"""Command line of the process: memory in MiB, seconds, niceness, process id of the one that started it."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One job, as its process gets it.

    Attributes:
        job: its id.
        photo: path of the photo on this machine.
        photo_sha256: hex digest that the photo has to have.
        options: JSON values of ``service.options.Options``.
        artifacts: fsspec URL of the store, for finished stages.
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

    def line(self) -> bytes:
        """One line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"


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

    def problem(self, problem: Mapping[str, Any]) -> None:
        """There will be no archive."""
        self._say({"problem": problem})

    def _say(self, message: Mapping[str, Any]) -> None:
        self._stream.write(json.dumps(message).encode() + b"\n")


Program = Callable[[Task, Reporter], None]
"""Computes a job and says ``done``; a fault leaves as an exception."""


def serve_one(load: Callable[[], Program]) -> int:
    """The main function of a job's process: limits first, then loading, then one task.

    Args:
        load: imports what the program needs.
    """
    from service.jobs.limits import end_with, limit_self

    memory, seconds, niceness, parent = (float(text) for text in sys.argv[1 : 1 + ARGUMENTS])
    reporter = Reporter()
    limit_self(int(memory), seconds, int(niceness), int(parent))
    pipe: BinaryIO = sys.stdin.buffer
    program = load()
    reporter.ready()
    line = pipe.readline()
    if not line:
        return 0
    end_with(pipe.fileno())
    task = Task(**json.loads(line))
    try:
        program(task, reporter)
    except Exception as error:  # whatever it is, the job has to end with an answer
        _problem(reporter, error)
    return 0


def _problem(reporter: Reporter, error: Exception) -> None:
    import logging

    from service.errors import AvatarError, OutOfMemory
    from service.jobs.problems import from_error
    from service.runtime.memory import lacked_memory

    if isinstance(error, OutOfMemory) or lacked_memory(error):
        reporter.problem(from_error(OutOfMemory("the computation needs more memory than this server allows")))
        return
    if not isinstance(error, AvatarError) or error.http_status >= 500:
        logging.getLogger(__name__).error("the job failed", exc_info=error)
    reporter.problem(from_error(error))
