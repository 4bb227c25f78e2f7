"""Whether one more job is let in, and when its turn is: decided inside the transaction that stores it.

Turns are start tags of start-time fair queueing (Goyal, Vin, Cheng 1996) with jobs of equal cost: a tenant's next job
gets the turn after that of its last unfinished one, and somebody who has none gets the turn that is being served.
However many jobs one tenant has waiting, another one's next job is thus behind at most one of them for each worker. The
queues of DBOS know priorities, which the turns are given as, but no shares: one tenant's thousand jobs would come
before all that is posted after them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import sqlalchemy as sa

from service.jobs import telemetry
from service.jobs.database import IS_SERVED, IS_UNFINISHED, IS_URGENT, IS_WAITING, JOBS, TALLIES, now

UNFINISHED = ("queued", "running")

PRIORITIES = ("high", "normal", "low")
"""Before and after what else the same tenant has waiting; "low" also gives way to the other tenants' jobs."""

LOW = 1 << 30
"""Turns from here on are those of low priority: whatever waits before them comes first."""

DAY_S = 86400.0

_REFUSED = "refused"
"""Name of the tally of refused photos: by tenant and hour."""

_LOCK = 4242002
"""Advisory lock of Postgres that makes admissions one after the other; SQLite has one writer at a time anyway."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """How much may be let in.

    Attributes:
        queued: jobs that may wait, all tenants together.
        unfinished: jobs of this tenant that may be unfinished.
        per_day: jobs of this tenant in 24 hours, those that are gone and refused photos included; None for no limit.
    """

    queued: int
    unfinished: int
    per_day: int | None = None


class NoRoom(Exception):
    """A job was not let in: ``kind`` is "queue-full" or "quota", ``facts`` the bound that was reached, by name."""

    def __init__(self, kind: str, **facts: int) -> None:
        super().__init__(kind)
        self.kind = kind
        self.facts = facts


def lock(connection: sa.Connection) -> None:
    """Let no other admission happen until this transaction ends."""
    if connection.dialect.name != "sqlite":
        connection.execute(sa.text("select pg_advisory_xact_lock(:key)"), {"key": _LOCK})


def check(connection: sa.Connection, tenant: str, bounds: Bounds, *, counted: int = 0) -> None:
    """Refuse one more job where a bound is reached, by :class:`NoRoom`.

    Rows are counted as far as the bound, by an index. The transaction has written already (SQLite locks with the first
    write) or holds :func:`lock`. ``counted`` is 1 where the job is among the rows already.
    """

    def reached(bound: int, *conditions: sa.ColumnElement[bool] | sa.TextClause) -> bool:
        found = sa.select(sa.literal(1)).select_from(JOBS).where(*conditions).limit(bound + counted).subquery()
        return int(connection.execute(sa.select(sa.func.count()).select_from(found)).scalar_one()) >= bound + counted

    if reached(bounds.queued, IS_WAITING):
        raise NoRoom("queue-full", queued=bounds.queued)
    if reached(bounds.unfinished, IS_UNFINISHED, JOBS.c.tenant == tenant):
        raise NoRoom("quota", max_unfinished=bounds.unfinished)
    if bounds.per_day is not None:
        lately = (JOBS.c.tenant == tenant, JOBS.c.created_at >= now() - DAY_S)
        refused = sa.select(sa.func.sum(TALLIES.c.value)).where(*_refusals(tenant), TALLIES.c.bucket > _hour(-24))
        left = bounds.per_day - int(connection.execute(refused).scalar_one() or 0)
        if left <= 0 or reached(left, *lately):
            raise NoRoom("quota", per_day=bounds.per_day)


def count_refusal(engine: sa.Engine, tenant: str) -> None:
    """Count a photo that was looked at and refused in the daily quota of its tenant: it was work, and made no job."""
    with engine.begin() as connection:
        connection.execute(sa.delete(TALLIES).where(*_refusals(tenant), TALLIES.c.bucket <= _hour(-24)))
        telemetry.count(connection, _REFUSED, tenant, bucket=_hour())


def _refusals(tenant: str) -> tuple[sa.ColumnElement[bool], ...]:
    return TALLIES.c.name == _REFUSED, TALLIES.c.label == tenant


def _hour(offset: int = 0) -> str:
    """Hours since 1970, the bucket of refusals; as many digits for the next century."""
    return str(int(now() // 3600) + offset)


def turn(connection: sa.Connection, tenant: str, job: str, priority: str) -> int:
    """The turn of a new job, whose row is there already; smaller ones are served first. The transaction is as for
    :func:`check`.
    """
    low = JOBS.c.turn >= LOW if priority == "low" else JOBS.c.turn < LOW
    turns = sa.select(JOBS.c.turn).where(JOBS.c.id != job, low).order_by(JOBS.c.turn.desc()).limit(1)
    being_served = connection.execute(turns.where(IS_SERVED)).scalar_one_or_none() or 1
    behind_own = connection.execute(turns.where(IS_UNFINISHED, JOBS.c.tenant == tenant)).scalar_one_or_none()
    first = LOW if priority == "low" else 1
    return int(max(being_served, first, 0 if behind_own is None else behind_own + 1))


def give_way(connection: sa.Connection, job: sa.RowMapping) -> sa.RowMapping | None:
    """The job that uses a turn that has come: of high priority where the tenant has one waiting, else the turn's own.

    The two exchange their workflows and their turns. Those of the tenant stay the same, only who has which changes, so
    nobody else waits longer for it; and however many wait, only two rows change. None where somebody else has just
    changed one of the two, and the transaction is to be given up.
    """
    if job["state"] != "queued" or job["priority"] != "normal":
        return job
    same = (JOBS.c.tenant == job["tenant"], JOBS.c.kind == job["kind"])
    first = sa.select(JOBS).where(IS_URGENT, *same).order_by(JOBS.c.turn).limit(1)
    urgent = connection.execute(first).mappings().one_or_none()
    if urgent is None:
        return job
    for row, other in ((urgent, job), (job, urgent)):
        unchanged = (JOBS.c.id == row["id"], JOBS.c.workflow == row["workflow"], JOBS.c.state == "queued")
        values = {"workflow": other["workflow"], "turn": other["turn"]}
        if not connection.execute(sa.update(JOBS).where(*unchanged).values(**values)).rowcount:
            return None
    return urgent


@dataclass(frozen=True, kw_only=True)
class NewJob:
    """A job to be stored.

    Attributes:
        id: 32 hex digits, random.
        tenant: whose it is.
        options: JSON values of ``service.options.Options``; of a derived kind the request under ``request``.
        photo: name of the artifact, "" for a derived kind.
        photo_sha256, photo_bytes: of the photo as it was sent.
        keep_photo: do not erase the photo when the job ends.
        key: the Idempotency-Key, None without one.
        digest: of everything that makes the request what it is.
        kind: of ``service.jobs.view``.
        source: of a derived kind, the job whose result it is made of.
        priority: of ``service.jobs.admission.PRIORITIES``.
        metadata: words of the owner's own.
        webhook: address that is told of the end, None for nobody.
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

    def row(self) -> dict[str, Any]:
        """Columns of the job as it is stored first."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return given | {
            "workflow": f"{self.id}.1", "state": "queued", "stage": None, "progress": 0.0, "created_at": now(),
            "updated_at": now(), "options": json.dumps(self.options), "metadata": json.dumps(self.metadata),
            "warnings": "[]", "timings": "{}", "crashes": 0, "events": 0, "swept": False, "turn": 0,
        }  # fmt: skip


class KeyInUse(Exception):
    """There is a job for this Idempotency-Key; ``row`` is that job."""

    def __init__(self, row: sa.RowMapping) -> None:
        super().__init__("there is a job for this key")
        self.row = row
