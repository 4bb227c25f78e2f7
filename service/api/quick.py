"""``GET /v1/avatars/{id}`` on a short way: clients ask for it more often than for anything else.

The body of a job's last event is the state of the job, so one look-up by key gives the whole answer. Whatever is not a
plain success (no such job, somebody else's, gone, a database that is busy) goes the long way through the routes.
"""

from __future__ import annotations

import contextlib
import re
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.jobs.view import FINAL

if TYPE_CHECKING:
    from service.api.context import Context

_ADDRESS = re.compile(r"/v1/avatars/([0-9a-f]{32})\Z")

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


@dataclass(frozen=True)
class _Route:
    """What the log and the numbers call these requests."""

    path: str


_ROUTE = _Route("/v1/avatars/{job}")


class QuickState:
    """The layer that answers such requests, around the application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on."""
        plain = scope["type"] == "http" and scope["method"] == "GET" and not scope["query_string"]
        match = _ADDRESS.match(scope["path"]) if plain else None
        found = _look(scope, match[1]) if match is not None else None
        if found is None:
            await self._app(scope, receive, send)
            return
        body, final = found
        headers = [
            (b"content-type", b"application/json"),
            (b"content-length", str(len(body)).encode()),
            (b"cache-control", b"no-store"),
        ]
        if not final:
            headers.append((b"retry-after", b"1"))
        scope["route"] = _ROUTE
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})


def _look(scope: Scope, job: str) -> tuple[bytes, bool] | None:
    context: Context = scope["app"].state.context
    tenant = context.keys.tenant(Headers(scope=scope))
    return None if tenant is None else context.glance.state(job, tenant.name)
