"""Questions to the table of jobs; nothing here changes anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from service.jobs.database import EVENTS, JOBS

Row = sa.RowMapping


class Lookups:
    """Answers about jobs; safe for many threads and processes at once."""

    def __init__(self, engine: sa.Engine) -> None:
        self.engine = engine

    def get(self, job: str) -> Row | None:
        """The row of a job, None where there is none."""
        return self._one(sa.select(JOBS).where(JOBS.c.id == job))

    def by_key(self, tenant: str, key: str) -> Row | None:
        """The row of the job with this Idempotency-Key."""
        return self._one(sa.select(JOBS).where(JOBS.c.tenant == tenant, JOBS.c.key == key))

    def page(self, tenant: str, limit: int, after: tuple[float, str] | None, state: str | None = None) -> list[Row]:
        """Avatars of a tenant, newest first, those that are gone left out.

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
        """Options, times and memory of the last avatars that succeeded."""
        columns = (JOBS.c.options, JOBS.c.timings, JOBS.c.peak_rss_mb, JOBS.c.started_at, JOBS.c.finished_at)
        query = sa.select(*columns).where(JOBS.c.state == "succeeded", JOBS.c.kind == "avatar")
        return self._all(query.order_by(JOBS.c.finished_at.desc()).limit(limit))

    def where(self, *conditions: sa.ColumnElement[bool], limit: int = 1000) -> list[Row]:
        """Rows under conditions on ``JOBS``, oldest first."""
        return self._all(sa.select(JOBS).where(*conditions).order_by(JOBS.c.created_at).limit(limit))

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
