"""Messages that wait to be sent: tried again with growing pauses, and given up after a day."""

from __future__ import annotations

import logging
from pathlib import Path

import sqlalchemy as sa

from service.errors import UsageError
from service.jobs import tallies
from service.jobs.clock import now
from service.jobs.database import MESSAGES
from service.jobs.settings import Settings
from service.jobs.webhooks.address import target
from service.jobs.webhooks.post import send

log = logging.getLogger(__name__)

PAUSES_S = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0)
"""Between two attempts; 16 hours in all."""

_LEASE_S = 60.0
"""Longest time of one attempt; a worker that dies in it leaves the message to another one after that."""

_AT_ONCE = 20


def deliver(engine: sa.Engine, settings: Settings) -> int:
    """Send what is due; returns how many messages arrived. Several workers may do it at once.

    Args:
        engine: of the database.
        settings: hosts that may be told, and the secret.
    """
    if not settings.webhook_hosts:
        return 0
    secret = Path(settings.webhook_secret).read_bytes().strip()
    due = sa.select(MESSAGES).where(MESSAGES.c.next_at <= now()).order_by(MESSAGES.c.next_at).limit(_AT_ONCE)
    with engine.connect() as connection:
        rows = list(connection.execute(due).mappings())
    return sum(_one(engine, settings, secret, row) for row in rows if _claimed(engine, row))


def _claimed(engine: sa.Engine, row: sa.RowMapping) -> bool:
    """Whether this worker is the one that tries a message now."""
    same = (MESSAGES.c.id == row["id"], MESSAGES.c.next_at == row["next_at"])
    with engine.begin() as connection:
        return bool(connection.execute(sa.update(MESSAGES).where(*same).values(next_at=now() + _LEASE_S)).rowcount)


def _one(engine: sa.Engine, settings: Settings, secret: bytes, row: sa.RowMapping) -> bool:
    facts = {"job": row["job"], "attempt": row["tries"] + 1}
    private = settings.webhook_private
    try:
        where = target(row["url"], settings.webhook_hosts, private=private)
        status = send(where, row["id"], int(now()), row["body"].encode(), secret, private=private)
        said = f"status {status}"
    except (OSError, UsageError) as error:
        status, said = 0, f"{type(error).__name__}: {error}"
    arrived = 200 <= status < 300
    over = arrived or row["tries"] >= len(PAUSES_S)
    with engine.begin() as connection:
        if over:
            connection.execute(sa.delete(MESSAGES).where(MESSAGES.c.id == row["id"]))
            tallies.count(connection, "webhooks", "arrived" if arrived else "given up")
        else:
            values = {"tries": row["tries"] + 1, "next_at": now() + PAUSES_S[row["tries"]]}
            connection.execute(sa.update(MESSAGES).where(MESSAGES.c.id == row["id"]).values(**values))
    if not arrived:
        log.warning("a webhook did not arrive%s: %s", " and is given up" if over else "", said, extra=facts)
    return arrived
