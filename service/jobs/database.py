"""The database of the service, SQLite or Postgres: tables, engine, clock, and patience while it fails.

DBOS keeps its own tables in the same database, so that a job and its place in the queue are written in one transaction.
"""

from __future__ import annotations

import hashlib
import logging
import os
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import filelock
import sqlalchemy as sa
from sqlalchemy import event

from service.errors import UsageError
from service.jobs.settings import Settings

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


TABLES = sa.MetaData()

IS_WAITING = sa.text("state = 'queued'")
IS_URGENT = sa.text("state = 'queued' and priority = 'high'")
IS_UNFINISHED = sa.text("state in ('queued', 'running')")
IS_SERVED = sa.text("started_at is not null")
IS_LEFTOVER = sa.text("swept = false and state in ('succeeded', 'failed', 'cancelled')")
IS_TOMBSTONE = sa.text("gone is not null")
IS_DERIVED = sa.text("source is not null")
"""Conditions on ``JOBS`` that have an index each, which holds only the rows that fit: what asks by one of them does not
take longer with a longer queue. They are literal, as a database does not know of a parameter whether it fits.
"""


def _index(name: str, *columns: str, where: sa.TextClause) -> sa.Index:
    return sa.Index(f"avatarme_jobs_{name}", *columns, postgresql_where=where, sqlite_where=where)


JOBS = sa.Table(
    "avatarme_jobs",
    TABLES,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("tenant", sa.String(64), nullable=False),
    sa.Column("workflow", sa.String(64), nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("stage", sa.String(64)),
    sa.Column("progress", sa.Double, nullable=False),
    sa.Column("created_at", sa.Double, nullable=False),
    sa.Column("updated_at", sa.Double, nullable=False),
    sa.Column("started_at", sa.Double),
    sa.Column("finished_at", sa.Double),
    sa.Column("expires_at", sa.Double),
    sa.Column("options", sa.Text, nullable=False),
    sa.Column("photo", sa.String(128), nullable=False),
    sa.Column("photo_sha256", sa.String(64), nullable=False),
    sa.Column("photo_bytes", sa.BigInteger, nullable=False),
    sa.Column("keep_photo", sa.Boolean, nullable=False),
    sa.Column("key", sa.String(255)),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("archive", sa.String(128)),
    sa.Column("archive_sha256", sa.String(64)),
    sa.Column("archive_bytes", sa.BigInteger),
    sa.Column("error", sa.Text),
    sa.Column("warnings", sa.Text, nullable=False),
    sa.Column("timings", sa.Text, nullable=False),
    sa.Column("peak_rss_mb", sa.Double),
    sa.Column("crashes", sa.Integer, nullable=False),
    sa.Column("losses", sa.Integer, nullable=False, server_default="0"),
    sa.Column("starved", sa.Integer, nullable=False, server_default="0"),
    sa.Column("events", sa.Integer, nullable=False),
    sa.Column("swept", sa.Boolean, nullable=False),
    sa.Column("gone", sa.String(16)),
    sa.Column("kind", sa.String(16), nullable=False, server_default="avatar"),
    sa.Column("source", sa.String(32)),
    sa.Column("priority", sa.String(8), nullable=False, server_default="normal"),
    sa.Column("turn", sa.Integer, nullable=False, server_default="0"),
    sa.Column("metadata", sa.Text, nullable=False, server_default="{}"),
    sa.Column("webhook", sa.Text),
    sa.UniqueConstraint("tenant", "key"),
    sa.Index("avatarme_jobs_list", "tenant", "created_at", "id"),
    sa.Index("avatarme_jobs_list_state", "tenant", "state", "created_at", "id"),
    sa.Index("avatarme_jobs_state", "state", "expires_at"),
    sa.Index("avatarme_jobs_workflow", "workflow"),
    _index("waiting", "kind", "turn", where=IS_WAITING),
    _index("oldest", "created_at", where=IS_WAITING),
    _index("urgent", "tenant", "kind", "turn", where=IS_URGENT),
    _index("own", "tenant", "turn", where=IS_UNFINISHED),
    _index("served", "turn", where=IS_SERVED),
    _index("leftover", "updated_at", where=IS_LEFTOVER),
    _index("tombstone", "updated_at", where=IS_TOMBSTONE),
    _index("derived", "source", where=IS_DERIVED),
)
"""``kind`` is one of :mod:`service.jobs.view`, ``source`` the job of whose result it is made, ``turn`` the place in
the queue (:mod:`service.jobs.admission`), ``metadata`` the own words of the owner as JSON, of a derived kind the facts,
``webhook`` the address that wants to know.
"""

TALLIES = sa.Table(
    "avatarme_tallies",
    TABLES,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("label", sa.String(64), primary_key=True),
    sa.Column("bucket", sa.String(16), primary_key=True),
    sa.Column("value", sa.Double, nullable=False),
)
"""Counts of :mod:`service.jobs.telemetry`: those that only grow outlive the rows of jobs."""

EVENTS = sa.Table(
    "avatarme_events",
    TABLES,
    sa.Column("job", sa.String(32), primary_key=True),
    sa.Column("n", sa.Integer, primary_key=True),
    sa.Column("name", sa.String(16), nullable=False),
    sa.Column("body", sa.Text, nullable=False),
)

WORKERS = sa.Table(
    "avatarme_workers",
    TABLES,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("version", sa.String(32), nullable=False),
    sa.Column("ready", sa.Boolean, nullable=False),
    sa.Column("fault", sa.Text),
    sa.Column("seen_at", sa.Double, nullable=False),
)

SHARDS = sa.Table(
    "avatarme_shards",
    TABLES,
    sa.Column("round", sa.String(64), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("photos", sa.Integer, nullable=False),
    sa.Column("done", sa.Integer, nullable=False, server_default="0"),
    sa.Column("failed", sa.Integer, nullable=False, server_default="0"),
    sa.Column("at", sa.Integer, nullable=False, server_default="-1"),
    sa.Column("losses", sa.Integer, nullable=False, server_default="0"),
    sa.Column("ended", sa.Boolean, nullable=False, server_default=sa.false()),
)
"""How far each shard of a batch is: photos that have an archive and that failed, the photo it is at, and how often in a
row a worker was lost with it. Number -1 is the round itself, which is called off when that has ended.
"""

LINE = {
    "connect_timeout": 10,
    "keepalives": 1, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3, "tcp_user_timeout": 30_000,
}  # fmt: skip
"""How soon a dead line to Postgres is noticed; the last one is for a question that is on its way, in milliseconds, for
which the system would wait a quarter of an hour.
"""


def connect(url: str, pool: int = 8, *, ping: bool = True) -> sa.Engine:
    """An engine for the URL of :class:`service.jobs.settings.Settings`, which keeps ``pool`` connections.

    With ``ping`` each connection is asked whether it lives before it is used; without it a call fails once after the
    database was away, for callers that try again (:func:`patient`).
    """
    if not url.startswith("sqlite"):
        return sa.create_engine(url, pool_size=pool, pool_pre_ping=ping, pool_timeout=10, connect_args=LINE)
    engine = sa.create_engine(url, pool_size=pool, connect_args={"timeout": 30})
    event.listen(engine, "connect", _sqlite)
    return engine


def _sqlite(connection: Any, _record: Any) -> None:
    connection.isolation_level = "IMMEDIATE"  # writers queue up instead of failing when a reader wants to write
    connection.execute("PRAGMA journal_mode=WAL")  # readers do not wait for writers
    connection.execute("PRAGMA synchronous=FULL")  # a commit is on the disk: a 202 must survive a power cut
    connection.execute("PRAGMA busy_timeout=30000")
    connection.execute("PRAGMA secure_delete=ON")  # what is erased is overwritten in the file, not only let go


def add_columns(connection: sa.Connection) -> None:
    """Add the columns that a database of an older version lacks; they have a default in the database.

    An older version that comes back finds columns that it does not know, and leaves them alone.
    """
    for table in TABLES.sorted_tables:
        known = {column["name"] for column in sa.inspect(connection).get_columns(table.name)}
        for column in table.columns:
            if column.name not in known:
                words = sa.schema.CreateColumn(column).compile(dialect=connection.dialect)
                connection.execute(sa.text(f"alter table {table.name} add column {words}"))
        for index in table.indexes:
            index.create(connection, checkfirst=True)


def seconds_of_database(engine: sa.Engine) -> sa.ColumnElement[float]:
    """SQL for the time of the database in seconds since 1970: one clock for all machines."""
    if engine.dialect.name == "sqlite":
        return sa.literal_column("((julianday('now') - 2440587.5) * 86400.0)", sa.Double)
    return sa.literal_column("extract(epoch from clock_timestamp())::double precision", sa.Double)


def create_tables(engine: sa.Engine, settings: Settings) -> None:
    """Make the tables of the service and of DBOS where they are missing; several processes may do it at once."""
    from dbos import DBOS

    held = FileLock(settings.data, "tables", TABLES_PATIENCE) if settings.database_url.startswith("sqlite") else None
    try:
        with engine.begin() as connection:
            if engine.dialect.name != "sqlite":
                connection.execute(sa.text("select pg_advisory_xact_lock(4242001)"))
            TABLES.create_all(connection)
            add_columns(connection)
        logging.getLogger("dbos").setLevel(logging.WARNING)
        DBOS.migrate(settings.database_url)
    finally:
        if held is not None:
            held.release()


_WALL = time.time()
_STEADY = time.monotonic()


def now() -> float:
    """Seconds since 1970 by the clock as it stood when this process started, counted on by the monotonic clock.

    Somebody who sets the machine's clock a day forward thereby neither expires results nor ends jobs.
    """
    return _WALL + (time.monotonic() - _STEADY)


T = TypeVar("T")

log = logging.getLogger(__name__)

TEMPORARY_FAILURE = 75
"""Exit status (EX_TEMPFAIL) of a worker that cannot reach its database or disk; it is started again."""

PATIENCE = 60.0
"""Seconds for which a step waits for its database or disk before the worker gives up."""


FAULTS = (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError)
"""What SQLAlchemy raises while a database is away."""


def _end_process(error: Exception) -> NoReturn:
    log.critical("this worker cannot reach its database or disk and ends")
    os._exit(TEMPORARY_FAILURE)


def patient(
    call: Callable[[], T], faults: tuple[type[Exception], ...] = (*FAULTS, OSError),
    give_up: Callable[[Exception], NoReturn] = _end_process,
) -> T:  # fmt: skip
    """Call again and again while the database or the disk fails; after ``PATIENCE`` give up.

    ``give_up`` ends this process unless told: an exception would be recorded as the result of the step, and the job
    would fail for what is not its fault. A new process takes the step up again.
    """
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return call()
        except faults as error:
            log.warning("waiting for database or disk: %s", str(error).partition("\n")[0])
            if time.monotonic() > deadline:
                give_up(error)
        time.sleep(0.5)
