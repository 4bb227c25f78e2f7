"""The process that makes one photo of a batch: the pipeline, its faults in their own words, its noise in a file."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

from service.archive.pack import write_archive
from service.batch.makers import LOG
from service.client.download import check_archive
from service.errors import AvatarError, UnreadableInput
from service.jobs.process import Reporter, Task
from service.options import Options
from service.photo.bundle import MOST, unbundled
from service.photo.limits import Limits, read_file
from service.pipeline import make_avatar

HEAD = "head"
"""Key in the task's options that names another head model, or null."""


def run(task: Task, reporter: Reporter) -> None:
    """Make the avatar, write the archive, say ``done``, or ``problem`` with code and message."""
    with (Path(task.scratch) / LOG).open("wb") as log:
        for stream in (sys.stderr, sys.stdout):
            os.dup2(log.fileno(), stream.fileno())
    try:
        warnings = make(task, reporter)
        check_archive(Path(task.output))
        reporter.done({"warnings": warnings})
    except AvatarError as error:
        reporter.problem(error.described())


def make(task: Task, reporter: Reporter) -> list[str]:
    """Write the archive; returns the warnings.

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    data = read_file(task.photo, limit=MOST * Limits().max_bytes)
    if hashlib.sha256(data).hexdigest() != task.photo_sha256:
        raise UnreadableInput(f"{task.photo} was changed while the batch ran")
    asked = {name: tuple(value) if isinstance(value, list) else value for name, value in task.options.items()}
    head = asked.pop(HEAD, None)
    options = Options(**asked)  # type: ignore[arg-type]
    avatar = make_avatar(unbundled(data), options, reporter.progress, None if head is None else Path(str(head)))
    write_archive(avatar, Path(task.output))
    return list(avatar.all_warnings())
