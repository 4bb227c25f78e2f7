"""One look at the state of a job, so short that it may be taken between two other requests."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

from service.jobs.view import FINAL

_QUERY = (
    "select j.tenant, j.state, j.gone, e.body from avatarme_jobs j "
    "join avatarme_events e on e.job = j.id and e.n = j.events where j.id = ? and j.kind = 'avatar'"
)

_BUSY_S = 0.02
"""Longest time in seconds that a look-up may hold up all other requests."""


class Glance:
    """Looks at jobs without a thread: a connection of its own for reading, to a SQLite file on this machine.

    A database that is reached over a network may take its time, which would hold up all other requests; it is never
    asked in this way.

    Args:
        path: of the SQLite file, "" for another kind of database.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._connection: sqlite3.Connection | None = None

    def state(self, job: str, tenant: str) -> tuple[bytes, bool] | None:
        """JSON of a job and whether it has ended; None where the long way has to answer.

        Args:
            job: 32 hex digits.
            tenant: who asks.
        """
        if not self._path:
            return None
        try:
            if self._connection is None:
                self._connection = sqlite3.connect(
                    f"{Path(self._path).resolve().as_uri()}?mode=ro", timeout=_BUSY_S, uri=True, isolation_level=None,
                    check_same_thread=False,
                )  # fmt: skip
            rows = self._connection.execute(_QUERY, (job,)).fetchall()
        except sqlite3.Error:
            self.close()
            return None
        if not rows or rows[0][0] != tenant or rows[0][2] is not None:
            return None
        return rows[0][3].encode(), rows[0][1] in FINAL

    def close(self) -> None:
        """Let go of the file; it is opened again when it is needed."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(sqlite3.Error):
                connection.close()
