"""One process per name: a file lock on this machine, and in Postgres a lock that ends with the connection."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Collection
from pathlib import Path

import filelock
import sqlalchemy as sa

from service.errors import UsageError

_GRACE = 20.0
"""Seconds that Postgres may take to notice that the last worker of a name is gone."""
_HELD = """
select (classid::bigint << 32) | objid::bigint from pg_locks where locktype = 'advisory' and objsubid = 1 and granted
and database = (select oid from pg_database where datname = current_database())
"""
"""Keys of all locks on names, of any session."""

TABLES_PATIENCE = 120.0
"""Seconds that a process waits for another one to make the tables."""


class FileLock:
    """A lock on a file in the data folder, held until the process ends; UsageError where another process holds it.

    ``name`` is that of the lock, and of the kind of process in the message; ``patience`` are seconds to wait for
    whoever holds it. The folder is made where it is missing.
    """

    def __init__(self, folder: Path, name: str, patience: float = 0.0) -> None:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._lock = filelock.FileLock(folder / f"{name}.lock", timeout=patience, mode=0o600, thread_local=False)
        try:
            self._lock.acquire()
        except filelock.Timeout as error:
            raise UsageError(
                f"{folder} is in use by another {name}; wait, or give each a folder or worker name of its own",
                field="data",
            ) from error

    def release(self) -> None:
        """Let another process have it."""
        self._lock.release()


class DatabaseLock:
    """Advisory lock of Postgres on a worker's name, held by a connection of its own; nothing with SQLite.

    UsageError: another worker of that name lives.
    """

    def __init__(self, engine: sa.Engine, worker: str) -> None:
        self._connection: sa.Connection | None = None
        if engine.dialect.name == "sqlite":
            return
        self._connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        deadline = time.monotonic() + _GRACE
        query = sa.text("select pg_try_advisory_lock(:key)")
        while not self._connection.execute(query, {"key": key_of(worker)}).scalar_one():
            if time.monotonic() < deadline:
                time.sleep(0.5)
                continue
            self._connection.close()
            raise UsageError(f"there is another worker {worker!r}; give each one a name of its own", field="worker")

    def dead(self, workers: Collection[str]) -> set[str]:
        """Those of some workers whose lock nobody holds; none with SQLite, which has one worker only.

        SQLAlchemyError: the connection is lost, and with it the lock: this worker may have been replaced and has to
        end.
        """
        if self._connection is None:
            return set()
        held = set(self._connection.execute(sa.text(_HELD)).scalars())
        return {worker for worker in workers if key_of(worker) not in held}


def key_of(worker: str) -> int:
    """The 64-bit signed number that stands for a name."""
    return int.from_bytes(hashlib.sha256(f"avatarme worker {worker}".encode()).digest()[:8], "big", signed=True)
