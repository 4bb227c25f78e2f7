"""How a worker makes something of a finished avatar: the task of its process, and what came of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from service.jobs.artifacts import sha256_of
from service.jobs.kinds import Kind
from service.jobs.lookups import Row
from service.jobs.problems import problem
from service.jobs.settings import Settings
from service.jobs.wire import Task


def task(kind: Kind, row: Row, source: Row, settings: Settings, scratch: Path) -> Task:
    """What the process is told: the name of the avatar's archive, and the request.

    Args:
        kind: of the job.
        row: of the job.
        source: of the job whose archive it is made of.
        settings: of the worker.
        scratch: folder for the result.
    """
    return Task(
        job=row["id"], photo="", photo_sha256="",
        options={"archive": source["archive"], "request": json.loads(row["options"])["request"]},
        artifacts=settings.artifacts_url, output=str(scratch / kind.file), scratch=str(scratch),
    )  # fmt: skip


def facts(file: Path, said: dict[str, Any]) -> dict[str, Any]:
    """What is stored of a result.

    Args:
        file: that the process wrote.
        said: by the process.
    """
    with file.open("rb") as stream:
        digest = sha256_of(stream)
    size = file.stat().st_size
    return {"sha256": digest, "bytes": size, "warnings": [], "timings": {}, "peak_rss_mb": None, "facts": said}


def too_slow(kind: Kind, seconds: float) -> dict[str, Any]:
    """The problem of something that took too long."""
    return problem(f"{kind.name}-timeout", 504, kind.slow.format(seconds=seconds))


def gone() -> dict[str, Any]:
    """The problem of something whose avatar was erased while it waited."""
    return problem("gone", 410, "the avatar has expired or was erased")
