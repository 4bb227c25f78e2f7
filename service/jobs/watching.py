"""What a worker does while the process of a job runs: report how far it is, and see whether it is still wanted."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

import sqlalchemy as sa

from service.jobs.store import Store
from service.jobs.view import FINAL

LOOK = 0.4
"""Seconds between two looks at the database for a cancellation."""

WRITE = 0.5
"""Seconds between two reports of progress within a stage."""


class Report:
    """Progress from the process to the database, not too often; a report that fails is left out."""

    def __init__(self, store: Store, job: str) -> None:
        self._store, self._job = store, job
        self._stage, self._at = "", 0.0

    def __call__(self, message: dict[str, Any]) -> None:
        """Take a line of the process: a stage that begins, or one that is kept."""
        if "kept" in message:
            with contextlib.suppress(sa.exc.SQLAlchemyError):
                self._store.answered(self._job)
        stage, share = message.get("stage"), message.get("share")
        if not isinstance(stage, str) or not isinstance(share, int | float):
            return
        if stage == self._stage and time.monotonic() - self._at < WRITE:
            return
        known, self._stage, self._at = self._stage, stage, time.monotonic()
        with contextlib.suppress(sa.exc.SQLAlchemyError):
            self._store.progress(self._job, stage, share, known)


class Stop:
    """Whether a process is to end: the worker stops, or the job has ended because its owner wants it to."""

    def __init__(self, store: Store, job: str, stopping: threading.Event) -> None:
        self._store, self._job, self._stopping = store, job, stopping
        self._at = 0.0

    def __call__(self) -> bool:
        """Whether it is to end now."""
        if self._stopping.is_set():
            return True
        if time.monotonic() - self._at < LOOK:
            return False
        self._at = time.monotonic()
        try:
            row = self._store.get(self._job)
        except sa.exc.SQLAlchemyError:
            return False
        return row is None or row["state"] in FINAL
