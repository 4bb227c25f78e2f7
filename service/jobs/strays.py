"""Files that no job belongs to: uploads that were cut off, and what a store has of jobs that nobody knows."""

from __future__ import annotations

import time
from pathlib import Path

from service.jobs.artifacts import Artifacts
from service.jobs.lookups import Lookups
from service.jobs.settings import Settings

STRAY = 3600.0
"""Age in seconds of an upload that nobody finished."""

SEEN = 300.0
"""Seconds between the first look at something that nobody knows and its end.

A clock that is set by a day makes an upload under way look old; none takes that long (``Settings.body_seconds``).
"""


class Strays:
    """Looks for such files, and removes those that were there for long.

    Args:
        settings: of the worker.
        jobs: those that there are.
        artifacts: their files.
    """

    def __init__(self, settings: Settings, jobs: Lookups, artifacts: Artifacts) -> None:
        self._settings, self._jobs, self._artifacts = settings, jobs, artifacts
        self._unknown: dict[str, float] = {}

    def sweep(self) -> None:
        """Remove uploads that never became a job, and files of jobs that nobody knows."""
        incoming, artifacts = self._settings.incoming, self._artifacts
        unknown: dict[str, float] = {}
        for job in artifacts.jobs():
            if self._jobs.get(job) is None:
                age = None if artifacts.folder is None else _age(artifacts.folder / job)
                if self._is_stray(job, age, unknown):
                    artifacts.sweep(job, set())
        for path in incoming.glob("*") if incoming.is_dir() else ():
            if self._is_stray(path.name, _age(path), unknown):
                path.unlink(missing_ok=True)
        self._unknown = unknown

    def _is_stray(self, name: str, age: float | None, unknown: dict[str, float]) -> bool:
        """Whether something is old by the clock on the wall, and was seen long ago by the one that does not jump.

        Args:
            name: of it; when it was first seen is noted in ``unknown``.
            age: in seconds by the clock on the wall; None where only being seen tells, as on a remote store.
            unknown: of this look.
        """
        unknown[name] = self._unknown.get(name, time.monotonic())
        patience = max(STRAY if age is None else SEEN, 2 * self._settings.body_seconds)
        return (age is None or age >= STRAY) and time.monotonic() - unknown[name] >= patience


def _age(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return 0.0
