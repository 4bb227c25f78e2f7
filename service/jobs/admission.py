"""Whether one more job is let in, and when its turn is: decided inside the transaction that stores it.

Turns are start tags of start-time fair queueing (Goyal, Vin, Cheng 1996) with jobs of equal cost: a tenant's next job
gets the turn after that of its last unfinished one, and somebody who has none gets the turn that is being served.
However many jobs one tenant has waiting, another one's next job is thus behind at most one of them for each worker.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from service.jobs.database import JOBS, now

UNFINISHED = ("queued", "running")

PRIORITIES = ("high", "normal", "low")
"""Before and after what else the same tenant has waiting; "low" also gives way to the other tenants' jobs."""

LOW = 1 << 30
"""Turns from here on are those of low priority: whatever waits before them comes first."""

DAY_S = 86400.0

_LOCK = 4242002
"""Advisory lock of Postgres that makes admissions one after the other; SQLite has one writer at a time anyway."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """How much may be let in.

    Attributes:
        queued: jobs that may wait, all tenants together.
        unfinished: jobs of this tenant that may be unfinished.
        per_day: jobs of this tenant in 24 hours, those that are gone included; None for no limit.
    """

    queued: int
    unfinished: int
    per_day: int | None = None


class NoRoom(Exception):
    """A job was not let in.

    Args:
        kind: "queue-full" or "quota".
        facts: the bound that was reached, by name.
    """

    def __init__(self, kind: str, **facts: int) -> None:
        super().__init__(kind)
        self.kind = kind
        self.facts = facts


def lock(connection: sa.Connection) -> None:
    """Let no other admission happen until this transaction ends."""
    if connection.dialect.name != "sqlite":
        connection.execute(sa.text("select pg_advisory_xact_lock(:key)"), {"key": _LOCK})


def check(connection: sa.Connection, tenant: str, bounds: Bounds, *, counted: int = 0) -> None:
    """Refuse one more job where a bound is reached.

    Args:
        connection: in a transaction that has written already (SQLite locks with the first write) or holds :func:`lock`.
        tenant: whose job it is.
        bounds: what is allowed.
        counted: 1 where the job is among the rows already.

    Raises:
        NoRoom: it would be one too many.
    """
    mine = sa.func.sum(sa.case((JOBS.c.tenant == tenant, 1), else_=0))
    states = sa.select(JOBS.c.state, sa.func.count(), mine).where(JOBS.c.state.in_(UNFINISHED))
    queued = own = -counted
    for state, count, of_tenant in connection.execute(states.group_by(JOBS.c.state)):
        queued += count if state == "queued" else 0
        own += of_tenant
    if queued >= bounds.queued:
        raise NoRoom("queue-full", queued=queued)
    if own >= bounds.unfinished:
        raise NoRoom("quota", unfinished=own, max_unfinished=bounds.unfinished)
    if bounds.per_day is not None:
        lately = sa.select(sa.func.count()).where(JOBS.c.tenant == tenant, JOBS.c.created_at >= now() - DAY_S)
        if int(connection.execute(lately).scalar_one()) - counted >= bounds.per_day:
            raise NoRoom("quota", per_day=bounds.per_day)


def turn(connection: sa.Connection, tenant: str, job: str, priority: str) -> int:
    """The turn of a new job, whose row is there already; smaller ones are served first.

    Args:
        connection: as for :func:`check`.
        tenant: whose job it is.
        job: its id.
        priority: of ``PRIORITIES``.
    """
    low = JOBS.c.turn >= LOW if priority == "low" else JOBS.c.turn < LOW
    others = [JOBS.c.id != job, low]
    served = sa.select(JOBS.c.turn).where(*others, JOBS.c.started_at.is_not(None)).order_by(JOBS.c.turn.desc()).limit(1)
    last = sa.select(sa.func.max(JOBS.c.turn)).where(*others, JOBS.c.tenant == tenant, JOBS.c.state.in_(UNFINISHED))
    being_served = connection.execute(served).scalar_one_or_none() or 1
    behind_own = connection.execute(last).scalar_one()
    first = LOW if priority == "low" else 1
    return int(max(being_served, first, 0 if behind_own is None else behind_own + 1))


def overtake(connection: sa.Connection, tenant: str, job: str, own: int) -> list[tuple[str, str, int]]:
    """Put a new job of high priority before the tenant's waiting ones of normal priority.

    The turns of the tenant stay the same, only who has which changes: nobody else waits longer for it.

    Args:
        connection: as for :func:`check`.
        tenant: whose job it is.
        job: its id.
        own: its turn so far, the last of the tenant.

    Returns:
        (id, workflow, new turn) of every job that has got another turn, the new one included.
    """
    columns = (JOBS.c.id, JOBS.c.workflow, JOBS.c.turn)
    waiting = sa.select(*columns).where(
        JOBS.c.tenant == tenant, JOBS.c.state == "queued", JOBS.c.priority == "normal", JOBS.c.turn < LOW
    )
    rows: list[Any] = list(connection.execute(waiting.order_by(JOBS.c.turn)))
    turns = [*(row.turn for row in rows), own]
    moved = [(job, f"{job}.1", turns[0])]
    moved += [(row.id, row.workflow, after) for row, after in zip(rows, turns[1:], strict=True)]
    for name, _, place in moved:
        connection.execute(sa.update(JOBS).where(JOBS.c.id == name).values(turn=place))
    return moved


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
        kind: of ``service.jobs.kinds``.
        source: of a derived kind, the job whose result it is made of.
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

    def row(self) -> dict[str, Any]:
        """Columns of the job as it is stored first."""
        return {
            "id": self.id, "tenant": self.tenant, "workflow": f"{self.id}.1", "state": "queued", "stage": None,
            "progress": 0.0, "created_at": now(), "updated_at": now(), "options": json.dumps(self.options),
            "photo": self.photo, "photo_sha256": self.photo_sha256, "photo_bytes": self.photo_bytes,
            "keep_photo": self.keep_photo, "key": self.key, "digest": self.digest, "warnings": "[]", "timings": "{}",
            "crashes": 0, "events": 0, "swept": False, "kind": self.kind, "source": self.source,
            "priority": self.priority, "turn": 0, "metadata": json.dumps(self.metadata), "webhook": self.webhook,
            "trace": self.trace,
        }  # fmt: skip


class KeyInUse(Exception):
    """There is a job for this Idempotency-Key; ``row`` is that job."""

    def __init__(self, row: sa.RowMapping) -> None:
        super().__init__("there is a job for this key")
        self.row = row
