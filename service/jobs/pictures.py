"""How a worker has a picture rendered: the task of its process, its limits, and what came of it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from service.jobs.artifacts import sha256_of
from service.jobs.problems import problem
from service.jobs.settings import Settings
from service.jobs.store import Row
from service.jobs.wire import Task

FILE = "picture.png"


def limits(settings: Settings) -> Settings:
    """Settings of the process that renders: those of a job's, with another program and deadline."""
    return dataclasses.replace(settings, program=settings.render_program, job_seconds=settings.render_seconds)


def task(row: Row, source: Row, settings: Settings, scratch: Path) -> Task:
    """What the process is told.

    Args:
        row: of the picture's job.
        source: of the job whose archive is rendered.
        settings: of the worker.
        scratch: folder for the picture.
    """
    return Task(
        job=row["id"], photo="", photo_sha256="",
        options={"archive": source["archive"], "request": json.loads(row["options"])["request"]},
        artifacts=settings.artifacts_url, output=str(scratch / FILE), scratch=str(scratch),
    )  # fmt: skip


def facts(file: Path, said: dict[str, Any]) -> dict[str, Any]:
    """What is stored of a picture that is made.

    Args:
        file: the PNG.
        said: by the process.
    """
    with file.open("rb") as stream:
        digest = sha256_of(stream)
    size = file.stat().st_size
    return {"sha256": digest, "bytes": size, "warnings": [], "timings": {}, "peak_rss_mb": None, "facts": said}


def too_slow(seconds: float) -> dict[str, Any]:
    """The problem of a picture that took too long."""
    words = f"rendering took more than {seconds:g} s; ask for a smaller picture"
    return problem("render-timeout", 504, words)


def gone() -> dict[str, Any]:
    """The problem of a picture whose avatar was erased while it waited."""
    return problem("gone", 410, "the avatar has expired or was erased")
