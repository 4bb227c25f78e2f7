"""What is known of the jobs: rows that change in one transaction together with the event that tells of the change.

A job goes queued -> running -> succeeded | failed | cancelled, and the first final state stays: a worker that was
thought dead and wakes up can change nothing.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from service.jobs import admission, life, tallies, traces
from service.jobs.admission import UNFINISHED, Bounds
from service.jobs.clock import now
from service.jobs.database import EVENTS, JOBS, MESSAGES
from service.jobs.view import FINAL, job_json

MEASURED = ("quality", "size", "maps")
"""Options that say what the time of a job was needed for."""

_FOLD_S = 0.25
"""Longest time in seconds that emptying the write-ahead log waits for readers."""

Row = sa.RowMapping


@dataclass(frozen=True, kw_only=True)
class NewJob:
    """A job to be stored.

    Attributes:
        id: 32 hex digits, random.
        tenant: whose it is.
        options: JSON values of ``service.options.Options``.
        photo: name of the artifact.
        photo_sha256, photo_bytes: of the photo as it was sent.
        keep_photo: do not erase the photo when the job ends.
        key: the Idempotency-Key, None without one.
        digest: of everything that makes the request what it is.
        kind: "avatar" or "render".
        source: of a render, the job whose result it shows.
        priority: of ``service.jobs.admission.PRIORITIES``.
        metadata: words of the owner's own.
        webhook: address that is told of the end, None for nobody.
        trace: the trace that the request belongs to, as its header ``traceparent``; None for none.
    """

    id: str
    tenant: str
    options: Mapping[str, Any]
    photo: str
    photo_sha256: str
    photo_bytes: int
    keep_photo: bool
    key: str | None
    digest: str
    kind: str = "avatar"
    source: str | None = None
    priority: str = "normal"
    metadata: Mapping[str, Any] = field(default_factory=dict)
    webhook: str | None = None
    trace: str | None = None


OWNERS = {
    "key": None, "digest": "", "photo": "", "photo_sha256": "", "photo_bytes": 0, "metadata": "{}",
}  # fmt: skip
"""Columns that tell of the photo and of the request, as they are when nothing of both may be known any more."""


class KeyInUse(Exception):
    """There is a job for this Idempotency-Key; ``row`` is that job."""

    def __init__(self, row: Row) -> None:
        super().__init__("there is a job for this key")
        self.row = row


class Store:
    """Reads and changes jobs; safe for many threads and processes at once."""

    def __init__(self, engine: sa.Engine) -> None:
        self.engine = engine

    def add(
        self, job: NewJob, enqueue: Callable[[sa.Connection, Row], None], bounds: Bounds | None = None,
        move: Callable[[sa.Connection, str, int], None] | None = None,
    ) -> Row:  # fmt: skip
        """Let a job in, store it and put it into the queue, in one transaction.

        Args:
            job: the job.
            enqueue: called with the connection and the row, inside the transaction.
            bounds: what is allowed; None for anything.
            move: gives a workflow that waits another turn, inside the transaction; needed for high priority.

        Raises:
            KeyInUse: another job of this tenant has the key.
            NoRoom: a bound is reached.
        """
        try:
            with self.engine.begin() as connection:
                admission.lock(connection)
                connection.execute(sa.insert(JOBS).values(**_values(job)))
                if bounds is not None:
                    admission.check(connection, job.tenant, bounds, counted=1)
                turn = admission.turn(connection, job.tenant, job.id, job.priority)
                connection.execute(sa.update(JOBS).where(JOBS.c.id == job.id).values(turn=turn))
                moved = admission.overtake(connection, job.tenant, job.id, turn) if job.priority == "high" else []
                row = self._tell(connection, job.id, "state")
                enqueue(connection, row)
                for _, workflow, place in moved:
                    if move is not None:
                        move(connection, workflow, place)
        except sa.exc.IntegrityError:
            found = self.by_key(job.tenant, job.key) if job.key is not None else None
            if found is None:
                raise
            raise KeyInUse(found) from None
        life.accepted(row)
        return row

    def room(self, tenant: str, bounds: Bounds) -> None:
        """Whether one more job would be let in now; :meth:`add` decides.

        Raises:
            NoRoom: it would not.
        """
        with self.engine.connect() as connection:
            admission.check(connection, tenant, bounds)

    def get(self, job: str) -> Row | None:
        """The row of a job, None where there is none."""
        return self._one(sa.select(JOBS).where(JOBS.c.id == job))

    def by_key(self, tenant: str, key: str) -> Row | None:
        """The row of the job with this Idempotency-Key."""
        return self._one(sa.select(JOBS).where(JOBS.c.tenant == tenant, JOBS.c.key == key))

    def page(self, tenant: str, limit: int, after: tuple[float, str] | None, state: str | None = None) -> list[Row]:
        """Jobs of a tenant, newest first, those that are gone left out.

        Args:
            tenant: whose.
            limit: at most so many.
            after: (created_at, id) of the last job of the page before.
            state: only those in this state.
        """
        query = sa.select(JOBS).where(JOBS.c.tenant == tenant, JOBS.c.gone.is_(None), JOBS.c.kind == "avatar")
        if after is not None:
            query = query.where(sa.tuple_(JOBS.c.created_at, JOBS.c.id) < sa.tuple_(*after))
        if state is not None:
            query = query.where(JOBS.c.state == state)
        return self._all(query.order_by(JOBS.c.created_at.desc(), JOBS.c.id.desc()).limit(limit))

    def versions(self, jobs: Sequence[str]) -> dict[str, int]:
        """Number of the last event of each of these jobs."""
        if not jobs:
            return {}
        with self.engine.connect() as connection:
            rows = connection.execute(sa.select(JOBS.c.id, JOBS.c.events).where(JOBS.c.id.in_(jobs)))
            return {row.id: row.events for row in rows}

    def events(self, job: str, after: int, limit: int = 500) -> list[Row]:
        """Events of a job with numbers above ``after``: ``n``, ``name``, ``body`` (JSON text)."""
        query = sa.select(EVENTS).where(EVENTS.c.job == job, EVENTS.c.n > after)
        return self._all(query.order_by(EVENTS.c.n).limit(limit))

    def counts(self, tenant: str | None = None) -> dict[str, int]:
        """Number of jobs in each state, of one tenant or of all."""
        query = sa.select(JOBS.c.state, sa.func.count()).where(JOBS.c.gone.is_(None)).group_by(JOBS.c.state)
        if tenant is not None:
            query = query.where(JOBS.c.tenant == tenant)
        with self.engine.connect() as connection:
            return {row.state: row[1] for row in connection.execute(query)}

    def measured(self, limit: int = 2000) -> list[Row]:
        """Options, times and memory of the last successful jobs."""
        columns = (JOBS.c.options, JOBS.c.timings, JOBS.c.peak_rss_mb, JOBS.c.started_at, JOBS.c.finished_at)
        query = sa.select(*columns).where(JOBS.c.state == "succeeded", JOBS.c.kind == "avatar")
        return self._all(query.order_by(JOBS.c.finished_at.desc()).limit(limit))

    def where(self, *conditions: sa.ColumnElement[bool], limit: int = 1000) -> list[Row]:
        """Rows under conditions on ``JOBS``, oldest first."""
        return self._all(sa.select(JOBS).where(*conditions).order_by(JOBS.c.created_at).limit(limit))

    def begin(self, job: str) -> bool:
        """The job runs from now on; False where it has ended."""
        first = sa.func.coalesce(JOBS.c.started_at, now())
        row = self._change(job, "state", UNFINISHED, state="running", started_at=first)
        if row is not None:
            life.started(row)
        return row is not None

    def progress(self, job: str, stage: str, share: float, known: str | None = None) -> bool:
        """The job is at ``stage``, and ``share`` in [0, 1] of the work is done; False where it does not run.

        A stage that is not ``known`` is one that begins.

        The share never falls: a run that was cut off passes its finished stages again, which is no loss of work.
        """
        share = min(max(share, 0.0), 1.0)
        most = sa.case((JOBS.c.progress > share, JOBS.c.progress), else_=share)
        row = self._change(job, "progress", ("running",), stage=stage, progress=most)
        if row is not None and stage != known:
            life.stage(row, stage)
        return row is not None

    def crashed(self, job: str) -> int:
        """Count one more crash of the job's process; returns how many there were."""
        return self._count(job, JOBS.c.crashes)

    def starved(self, job: str) -> int:
        """Count once more that the job's process ran out of memory; returns how often it did."""
        return self._count(job, JOBS.c.starved)

    def attempt(self, job: str) -> int:
        """A worker begins to compute the job; returns how many did so before and were never heard of again.

        A worker that dies cannot say so: what is counted are beginnings that :meth:`answered` did not follow.
        """
        return self._count(job, JOBS.c.losses) - 1

    def answered(self, job: str) -> None:
        """The worker saw the job get ahead, or its process end: what was lost before counts no more."""
        with self.engine.begin() as connection:
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job, JOBS.c.losses > 0).values(losses=0))

    def succeed(self, job: str, result: Mapping[str, Any], expires_at: float) -> bool:
        """The job has its archive; False where it had ended before.

        Args:
            job: which.
            result: ``archive`` (name of the artifact), ``sha256``, ``bytes``, ``warnings``, ``timings``,
                ``peak_rss_mb``; of a render also ``facts``.
            expires_at: when it is erased.
        """
        more = {"metadata": json.dumps(result["facts"])} if "facts" in result else {}
        return self._end(
            job, state="succeeded", progress=1.0, **more, expires_at=expires_at, archive=result["archive"],
            archive_sha256=result["sha256"], archive_bytes=result["bytes"], warnings=json.dumps(result["warnings"]),
            timings=json.dumps(result["timings"]), peak_rss_mb=result["peak_rss_mb"],
        )  # fmt: skip

    def fail(self, job: str, problem: Mapping[str, Any], expires_at: float) -> bool:
        """The job ends with a problem object; False where it had ended before."""
        # A picture is found by what it shows; one that failed may be asked for again.
        key = sa.case((JOBS.c.kind == "render", None), else_=JOBS.c.key)
        return self._end(job, state="failed", error=json.dumps(problem), expires_at=expires_at, key=key)

    def cancel(self, job: str, expires_at: float) -> bool:
        """The job ends because its owner wants it to; False where it had ended before.

        Nothing of the photo and of the request is known any more: the same request makes a new job.
        """
        return self._end(job, state="cancelled", expires_at=expires_at, **OWNERS)

    def depart(self, job: str, reason: str) -> None:
        """Results are no longer given out; ``reason`` is "expired" or "erased".

        What stays are the times, what they belong to, and what a quota counts; hashes, key and names go.
        """
        with self.engine.begin() as connection:
            where = (JOBS.c.id == job, JOBS.c.gone.is_(None), JOBS.c.state.in_(FINAL))
            options = connection.execute(sa.select(JOBS.c.options).where(*where)).scalar_one_or_none()
            if options is None:
                return
            kept = {name: value for name, value in json.loads(options).items() if name in MEASURED}
            values = {"gone": reason, "swept": False, "error": None, "warnings": "[]", "options": json.dumps(kept)}
            values |= {**OWNERS, "archive": None, "archive_sha256": None, "archive_bytes": None, "webhook": None}
            connection.execute(sa.update(JOBS).where(*where).values(updated_at=now(), **values))
            connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job))
            connection.execute(sa.delete(MESSAGES).where(MESSAGES.c.job == job))

    def set(self, job: str, **values: Any) -> None:
        """Set columns that tell the owner nothing."""
        with self.engine.begin() as connection:
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job).values(**values))

    def forget(self, job: str) -> None:
        """Remove the row and the events."""
        with self.engine.begin() as connection:
            connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job))
            connection.execute(sa.delete(JOBS).where(JOBS.c.id == job))

    def _count(self, job: str, column: sa.Column[int]) -> int:
        query = sa.update(JOBS).where(JOBS.c.id == job).values({column: column + 1}).returning(column)
        with self.engine.begin() as connection:
            return int(connection.execute(query).scalar_one())

    def checkpoint(self) -> bool:
        """Fold SQLite's write-ahead log into the database and empty it: what was overwritten is nowhere any more.

        Returns:
            Whether the log is empty; not so while somebody reads.
        """
        if self.engine.dialect.name != "sqlite":
            return True
        made = sqlite3.connect(str(self.engine.url.database), timeout=_FOLD_S)
        with contextlib.closing(made) as connection, contextlib.suppress(sqlite3.Error):
            return not connection.execute("pragma wal_checkpoint(truncate)").fetchone()[0]
        return False

    def _end(self, job: str, **values: Any) -> bool:
        """The job comes to its last state, is counted and told of; False where it had ended before."""
        with self.engine.begin() as connection:
            row = self._changed(connection, job, "state", UNFINISHED, stage=None, finished_at=now(), **values)
            if row is None:
                return False
            code = json.loads(row["error"]).get("code", "") if row["error"] else ""
            tallies.count(connection, tallies.ENDED, f"{row['kind']}/{row['state']}/{code}")
            tallies.count_stages(connection, json.loads(row["timings"]))
            if row["webhook"]:
                told = {"type": "job.ended", "job": job_json(row)}
                message = {"id": f"msg_{job}", "job": job, "url": row["webhook"], "body": json.dumps(told)}
                connection.execute(sa.insert(MESSAGES).values(**message, tries=0, next_at=now()))
        life.ended(row)
        traces.ended(row)
        return True

    def _change(self, job: str, event: str, states: Sequence[str], **values: Any) -> Row | None:
        with self.engine.begin() as connection:
            return self._changed(connection, job, event, states, **values)

    def _changed(
        self, connection: sa.Connection, job: str, event: str, states: Sequence[str], **values: Any
    ) -> Row | None:
        query = sa.update(JOBS).where(JOBS.c.id == job, JOBS.c.state.in_(states))
        if not connection.execute(query.values(updated_at=now(), **values)).rowcount:
            return None
        return self._tell(connection, job, event)

    def _tell(self, connection: sa.Connection, job: str, event: str) -> Row:
        """Number the next event of a job, and store the job as it is now as its body."""
        raised = sa.update(JOBS).where(JOBS.c.id == job).values(events=JOBS.c.events + 1)
        row = connection.execute(raised.returning(*JOBS.c)).mappings().one()
        body = json.dumps(job_json(row))
        connection.execute(sa.insert(EVENTS).values(job=job, n=row["events"], name=event, body=body))
        return row

    def _one(self, query: sa.Select[Any]) -> Row | None:
        with self.engine.connect() as connection:
            return connection.execute(query).mappings().one_or_none()

    def _all(self, query: sa.Select[Any]) -> list[Row]:
        with self.engine.connect() as connection:
            return list(connection.execute(query).mappings())


def workflows(row: Mapping[str, Any] | Row) -> list[str]:
    """Names of all workflows that a job ever had."""
    job, _, count = str(row["workflow"]).partition(".")
    return [f"{job}.{number}" for number in range(1, int(count) + 1)]


def _values(job: NewJob) -> dict[str, Any]:
    return {
        "id": job.id, "tenant": job.tenant, "workflow": f"{job.id}.1", "state": "queued", "stage": None,
        "progress": 0.0, "created_at": now(), "updated_at": now(), "options": json.dumps(job.options),
        "photo": job.photo, "photo_sha256": job.photo_sha256, "photo_bytes": job.photo_bytes,
        "keep_photo": job.keep_photo, "key": job.key, "digest": job.digest, "warnings": "[]", "timings": "{}",
        "crashes": 0, "events": 0, "swept": False, "kind": job.kind, "source": job.source, "priority": job.priority,
        "turn": 0, "metadata": json.dumps(job.metadata), "webhook": job.webhook,
        "trace": job.trace,
    }  # fmt: skip
