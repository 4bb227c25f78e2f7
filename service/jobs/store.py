"""What is known of the jobs: rows that change in one transaction together with the event that tells of the change.

A job goes queued -> running -> succeeded | failed | cancelled, and the first final state stays: a worker that was
thought dead and wakes up can change nothing.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from service.jobs import admission, telemetry
from service.jobs.admission import UNFINISHED, Bounds, KeyInUse, NewJob
from service.jobs.database import EVENTS, IS_DERIVED, IS_WAITING, JOBS, now
from service.jobs.queue import ATTEMPTS, Queue
from service.jobs.view import AVATAR, FINAL, KINDS, job_json

Row = sa.RowMapping


OWNERS = {
    "key": None, "digest": "", "photo": "", "photo_sha256": "", "photo_bytes": 0, "metadata": "{}",
}  # fmt: skip
"""Columns that tell of the photo and of the request, as they are when nothing of both may be known any more."""


class Store:
    """Reads and changes jobs; safe for many threads and processes at once."""

    def __init__(self, engine: sa.Engine) -> None:
        self.engine = engine
        self.queue = Queue(engine)

    def get(self, job: str) -> Row | None:
        """The row of a job, None where there is none."""
        return self._one(sa.select(JOBS).where(JOBS.c.id == job))

    def wanted(self, job: str) -> bool:
        """Whether a job is unfinished."""
        query = sa.select(JOBS.c.id).where(JOBS.c.id == job, JOBS.c.state.in_(UNFINISHED))
        with self.engine.connect() as connection:
            return connection.execute(query).scalar_one_or_none() is not None

    def by_key(self, tenant: str, key: str) -> Row | None:
        """The row of the job with this Idempotency-Key."""
        return self._one(sa.select(JOBS).where(JOBS.c.tenant == tenant, JOBS.c.key == key))

    def page(self, tenant: str, limit: int, after: Row | None, state: str | None = None) -> list[Row]:
        """Avatars of a tenant, newest first, beginning behind one: those in a ``state``, and none that are gone."""
        query = sa.select(JOBS).where(JOBS.c.tenant == tenant, JOBS.c.gone.is_(None), JOBS.c.kind == "avatar")
        if after is not None:
            query = query.where(sa.tuple_(JOBS.c.created_at, JOBS.c.id) < sa.tuple_(after["created_at"], after["id"]))
        if state is not None:
            query = query.where(JOBS.c.state == state)
        return self._all(query.order_by(JOBS.c.created_at.desc(), JOBS.c.id.desc()).limit(limit))

    def known(self) -> set[str]:
        """Ids of all jobs."""
        with self.engine.connect() as connection:
            return set(connection.execute(sa.select(JOBS.c.id)).scalars())

    def events(self, job: str, after: int, limit: int = 500) -> list[Row]:
        """Events of a job with numbers above ``after``: ``n``, ``name``, ``body`` (JSON text)."""
        query = sa.select(EVENTS).where(EVENTS.c.job == job, EVENTS.c.n > after)
        return self._all(query.order_by(EVENTS.c.n).limit(limit))

    def counts(self) -> dict[str, int]:
        """Number of jobs in each state that has any, those that are gone left out."""
        query = sa.select(JOBS.c.state, sa.func.count().label("jobs")).where(JOBS.c.gone.is_(None))
        return {row["state"]: row["jobs"] for row in self._all(query.group_by(JOBS.c.state))}

    def oldest(self) -> Row | None:
        """The job that waits longest."""
        return self._one(sa.select(JOBS).where(IS_WAITING).order_by(JOBS.c.created_at).limit(1))

    def at_work(self, head: int) -> list[Row]:
        """Jobs that run, and of each kind so many of those whose turns come next."""
        waiting = sa.select(JOBS).where(IS_WAITING).order_by(JOBS.c.turn).limit(head)
        parts = [sa.select(JOBS).where(JOBS.c.state == "running")]
        parts += [sa.select(waiting.where(JOBS.c.kind == kind).subquery()) for kind in KINDS]
        return self._all(sa.union_all(*parts))

    def measured(self, limit: int = 2000) -> list[Row]:
        """Options, times and memory of the last avatars that succeeded."""
        columns = (JOBS.c.options, JOBS.c.timings, JOBS.c.peak_rss_mb, JOBS.c.started_at, JOBS.c.finished_at)
        query = sa.select(*columns).where(JOBS.c.state == "succeeded", JOBS.c.kind == "avatar")
        return self._all(query.order_by(JOBS.c.finished_at.desc()).limit(limit))

    def where(self, *conditions: sa.ColumnElement[bool] | sa.TextClause, limit: int = 1000) -> list[Row]:
        """Rows under conditions on ``JOBS``, oldest first."""
        return self._all(sa.select(JOBS).where(*conditions).order_by(JOBS.c.created_at).limit(limit))

    def _one(self, query: sa.Select[Any]) -> Row | None:
        with self.engine.connect() as connection:
            return connection.execute(query).mappings().one_or_none()

    def _all(self, query: sa.Select[Any] | sa.CompoundSelect[Any]) -> list[Row]:
        with self.engine.connect() as connection:
            return list(connection.execute(query).mappings())

    def add(self, job: NewJob, bounds: Bounds | None = None) -> Row:
        """Let a job in, store it and put it into the queue, in one transaction.

        KeyInUse: another job of this tenant has the key. NoRoom: one of ``bounds`` is reached.
        """
        try:
            with self.engine.begin() as connection:
                admission.lock(connection)
                connection.execute(sa.insert(JOBS).values(**job.row()))
                if bounds is not None:
                    admission.check(connection, job.tenant, bounds, counted=1)
                turn = admission.turn(connection, job.tenant, job.id, job.priority)
                row = self._tell(connection, job.id, "state", turn=turn)
                self.queue.put(connection, row)
        except sa.exc.IntegrityError:
            found = self.by_key(job.tenant, job.key) if job.key is not None else None
            if found is None:
                raise
            raise KeyInUse(found) from None
        telemetry.log_accepted(row)
        return row

    def room(self, tenant: str, bounds: Bounds) -> None:
        """Whether one more job would be let in now, NoRoom if not; :meth:`add` decides."""
        with self.engine.connect() as connection:
            admission.check(connection, tenant, bounds)

    def begin(self, workflow: str) -> str | None:
        """A workflow has its turn: the job that uses it runs from now on.

        Gives the id of the job, whose workflow it now is; None where no unfinished job has it.
        """
        with self.engine.connect() as connection:
            while True:
                with connection.begin() as transaction:
                    query = sa.select(JOBS).where(JOBS.c.workflow == workflow)
                    found = connection.execute(query).mappings().one_or_none()
                    if found is None or found["state"] not in UNFINISHED:
                        return None
                    job = admission.give_way(connection, found)
                    first = sa.func.coalesce(JOBS.c.started_at, now())
                    row = None if job is None else self._changed(
                        connection, job["id"], "state", (job["state"],), JOBS.c.workflow == workflow, state="running",
                        started_at=first,
                    )  # fmt: skip
                    if job is None or row is None:  # somebody changed it meanwhile
                        transaction.rollback()
                        continue
                telemetry.log_started(row)
                return str(row["id"])

    def progress(self, job: str, stage: str, share: float, known: str | None = None) -> bool:
        """The job is at ``stage``, and ``share`` in [0, 1] of the work is done; False where it does not run.

        A stage that is not ``known`` is one that begins.

        The share never falls: a run that was cut off passes its finished stages again, which is no loss of work.
        """
        share = min(max(share, 0.0), 1.0)
        most = sa.case((JOBS.c.progress > share, JOBS.c.progress), else_=share)
        with self.engine.begin() as connection:
            row = self._changed(connection, job, "progress", ("running",), stage=stage, progress=most)
        if row is not None and stage != known:
            telemetry.log_stage(row, stage)
        return row is not None

    def attempt(self, job: str) -> int:
        """A worker begins to compute the job; returns how many did so before and were never heard of again.

        A worker that dies cannot say so: what is counted are beginnings that :meth:`answered` did not follow.
        """
        return self.count(job, JOBS.c.losses) - 1

    def answered(self, job: str) -> None:
        """The worker saw the job get ahead, or its process end: what was lost before counts no more."""
        with self.engine.begin() as connection:
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job, JOBS.c.losses > 0).values(losses=0))

    def succeed(self, job: str, result: Mapping[str, Any], expires_at: float) -> bool:
        """The job has its archive; False where it had ended before.

        ``result`` has ``archive`` (name of the artifact), ``sha256``, ``bytes``, ``warnings``, ``timings``,
        ``peak_rss_mb``; of a derived kind also ``facts``.
        """
        more: dict[str, Any] = {"metadata": json.dumps(result["facts"])} if "facts" in result else {}
        return self._end(
            job, state="succeeded", progress=1.0, **more, expires_at=expires_at, archive=result["archive"],
            archive_sha256=result["sha256"], archive_bytes=result["bytes"], warnings=json.dumps(result["warnings"]),
            timings=json.dumps(result["timings"]), peak_rss_mb=result["peak_rss_mb"],
        )  # fmt: skip

    def fail(self, job: str, problem: Mapping[str, Any], expires_at: float) -> bool:
        """The job ends with a problem object; False where it had ended before."""
        # What is derived is found by its content; where it failed, it may be asked for again.
        key = sa.case((JOBS.c.kind != AVATAR.name, None), else_=JOBS.c.key)
        return self._end(job, state="failed", error=json.dumps(problem), expires_at=expires_at, key=key)

    def cancel(self, job: str, expires_at: float) -> bool:
        """The job ends because its owner wants it to; False where it had ended before.

        Nothing of the photo and of the request is known any more, in earlier events neither: the same request makes a
        new job. Nobody is told of it by a webhook, as its owner knows.
        """
        return self._end(job, alone=True, state="cancelled", expires_at=expires_at, webhook=None, **OWNERS)

    def set(self, job: str, **values: Any) -> None:
        """Set columns that tell the owner nothing."""
        with self.engine.begin() as connection:
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job).values(**values))

    def count(self, job: str, column: sa.Column[int]) -> int:
        """Count once more what befell the job; returns how often it did."""
        query = sa.update(JOBS).where(JOBS.c.id == job).values({column: column + 1}).returning(column)
        with self.engine.begin() as connection:
            return int(connection.execute(query).scalar_one())

    def _end(self, job: str, *, alone: bool = False, **values: Any) -> bool:
        """The job comes to its last state, is counted and told of; False where it had ended before.

        With ``alone`` no earlier event stays.
        """
        while True:
            with self.engine.begin() as connection:
                before = connection.execute(sa.select(JOBS.c.state).where(JOBS.c.id == job)).scalar_one_or_none()
                if before not in UNFINISHED:
                    return False
                row = self._changed(connection, job, "state", (before,), stage=None, finished_at=now(), **values)
                if row is None:  # it began meanwhile
                    continue
                if alone:
                    connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job, EVENTS.c.n < row["events"]))
                if row["webhook"]:
                    self.queue.put_message(connection, row)
                code = json.loads(row["error"]).get("code", "") if row["error"] else ""
                telemetry.count(connection, telemetry.ENDED, f"{row['kind']}/{row['state']}/{code}")
                telemetry.count_stages(connection, json.loads(row["timings"]))
            telemetry.log_ended(row)
            return True

    def _changed(
        self, connection: sa.Connection, job: str, event: str, states: Sequence[str],
        *conditions: sa.ColumnElement[bool], **values: Any,
    ) -> Row | None:  # fmt: skip
        query = sa.update(JOBS).where(JOBS.c.id == job, JOBS.c.state.in_(states), *conditions)
        if not connection.execute(query.values(updated_at=now(), **values)).rowcount:
            return None
        return self._tell(connection, job, event)

    def _tell(self, connection: sa.Connection, job: str, event: str, **values: Any) -> Row:
        """Number the next event of a job, and store the job as it is now as its body."""
        raised = sa.update(JOBS).where(JOBS.c.id == job).values(events=JOBS.c.events + 1, **values)
        row = connection.execute(raised.returning(*JOBS.c)).mappings().one()
        body = json.dumps(job_json(row))
        connection.execute(sa.insert(EVENTS).values(job=job, n=row["events"], name=event, body=body))
        return row


def workflows(row: Mapping[str, Any] | Row) -> list[str]:
    """Names of the workflow of a job, and of those that tell of its end."""
    return [str(row["workflow"]), *(f"{row['id']}.told.{attempt}" for attempt in range(1, ATTEMPTS + 1))]


MEASURED = ("quality", "size", "maps")
"""Options that say what the time of a job was needed for."""

_FOLD_S = 0.25
"""Longest time in seconds that emptying the write-ahead log waits for readers."""


def let_go(store: Store, row: Row, reason: str, expires: float | None = None) -> list[str]:
    """Cancel a job that is unfinished, forget the result of one that has ended; the same for what was made of it.

    Gives the ids of the jobs whose files may go; whoever sweeps removes these. ``reason`` is "erased" or "expired"; a
    cancelled job says until ``expires`` that it was.
    """
    derived = store.where(IS_DERIVED, JOBS.c.source == row["id"], JOBS.c.gone.is_(None))
    for one in (*derived, row):
        if store.cancel(one["id"], now() if expires is None else expires):
            store.queue.cancel(one["workflow"])
        elif one["gone"] is None:
            depart(store.engine, one["id"], reason)
            store.queue.delete(workflows(one))  # results of steps name files by their hashes
    return [one["id"] for one in (*derived, row)]


def depart(engine: sa.Engine, job: str, reason: str) -> None:
    """Results are no longer given out; ``reason`` is "expired" or "erased".

    What stays are the times, what they belong to, and what a quota counts; hashes, key and names go.
    """
    with engine.begin() as connection:
        where = (JOBS.c.id == job, JOBS.c.gone.is_(None), JOBS.c.state.in_(FINAL))
        options = connection.execute(sa.select(JOBS.c.options).where(*where)).scalar_one_or_none()
        if options is None:
            return
        kept = {name: value for name, value in json.loads(options).items() if name in MEASURED}
        values = {"gone": reason, "swept": False, "error": None, "warnings": "[]", "options": json.dumps(kept)}
        values |= {**OWNERS, "archive": None, "archive_sha256": None, "archive_bytes": None, "webhook": None}
        if not connection.execute(sa.update(JOBS).where(*where).values(updated_at=now(), **values)).rowcount:
            return
        connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job))


def forget(engine: sa.Engine, job: str) -> None:
    """Remove the row and the events."""
    with engine.begin() as connection:
        connection.execute(sa.delete(EVENTS).where(EVENTS.c.job == job))
        connection.execute(sa.delete(JOBS).where(JOBS.c.id == job))


def checkpoint(engine: sa.Engine) -> bool:
    """Fold SQLite's write-ahead log into the database and empty it: what was overwritten is nowhere any more.

    Whether the log is empty; not so while somebody reads.
    """
    if engine.dialect.name != "sqlite":
        return True
    made = sqlite3.connect(str(engine.url.database), timeout=_FOLD_S)
    with contextlib.closing(made) as connection, contextlib.suppress(sqlite3.Error):
        return not connection.execute("pragma wal_checkpoint(truncate)").fetchone()[0]
    return False
