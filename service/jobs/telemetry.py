"""What is told of jobs to whoever runs the service: lines of the log, and counts."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from service.jobs.database import TALLIES, now

Row = sa.RowMapping

log = logging.getLogger(__name__)


def log_accepted(row: Row) -> None:
    """A job was stored and waits."""
    _log_line("accepted", row, priority=row["priority"], turn=row["turn"], bytes=row["photo_bytes"])


def log_started(row: Row) -> None:
    """A worker took a job up, for the first time or again."""
    _log_line("started", row, waited_s=round((row["started_at"] or now()) - row["created_at"], 3))


def log_stage(row: Row, name: str) -> None:
    """A job has come to its next stage."""
    began = row["started_at"] or row["created_at"]
    _log_line("stage", row, stage=name, after_s=round(now() - began, 3))


def log_ended(row: Row) -> None:
    """A job is in its last state. That somebody cancelled it, or that a photo cannot be used, is no fault of ours."""
    began = row["started_at"]
    problem = json.loads(row["error"]) if row["error"] else {}
    facts = {
        "state": row["state"], "code": problem.get("code"),
        "waited_s": None if began is None else round(began - row["created_at"], 3),
        "took_s": None if began is None else round((row["finished_at"] or now()) - began, 3),
        "stages_s": json.loads(row["timings"]), "peak_rss_mb": row["peak_rss_mb"], "crashes": row["crashes"],
    }  # fmt: skip
    level = logging.ERROR if int(problem.get("status", 0)) >= 500 else logging.INFO
    _log_line("ended", row, level, **facts)


def _log_line(event: str, row: Row, level: int = logging.INFO, **facts: Any) -> None:
    who = {"event": event, "job": row["id"], "tenant": row["tenant"], "kind": row["kind"]}
    log.log(level, "job %s", event, extra=who | facts)


ENDED, STAGES = "ended", "stages"
"""Names of the tallies that only grow: jobs that ended by ``kind/state/code``, seconds by stage."""

EDGES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Upper edges of the buckets of a stage's time in seconds; the last bucket has none."""

_SUM, _REST = "sum", "+Inf"


def count(connection: sa.Connection, name: str, label: str, by: float = 1.0, bucket: str = "") -> None:
    """Add to a count, in the caller's transaction."""
    insert = sqlite.insert if connection.dialect.name == "sqlite" else postgresql.insert
    query = insert(TALLIES).values(name=name, label=label[:64], bucket=bucket, value=by)
    more = {"value": TALLIES.c.value + by}
    connection.execute(query.on_conflict_do_update(index_elements=["name", "label", "bucket"], set_=more))


def count_stages(connection: sa.Connection, seconds: Mapping[str, float]) -> None:
    """Sort the times of a job's stages into their buckets."""
    for stage, spent in sorted(seconds.items()):  # in one order for all, or two transactions could wait for each other
        bucket = next((f"{edge:g}" for edge in EDGES if spent <= edge), _REST)
        count(connection, STAGES, stage, 1.0, bucket)
        count(connection, STAGES, stage, spent, _SUM)


def counts(engine: sa.Engine, name: str) -> dict[str, float]:
    """Label -> count."""
    query = sa.select(TALLIES.c.label, TALLIES.c.value).where(TALLIES.c.name == name, TALLIES.c.bucket == "")
    with engine.connect() as connection:
        return {row.label: row.value for row in connection.execute(query)}


def histograms(engine: sa.Engine) -> Iterator[tuple[str, list[tuple[str, float]], float]]:
    """(Stage, cumulative buckets as (upper edge, count), sum of seconds) of each stage."""
    found: dict[str, dict[str, float]] = {}
    with engine.connect() as connection:
        for row in connection.execute(sa.select(TALLIES).where(TALLIES.c.name == STAGES)):
            found.setdefault(row.label, {})[row.bucket] = row.value
    for stage, values in sorted(found.items()):
        total, buckets = 0.0, []
        for edge in (*(f"{edge:g}" for edge in EDGES), _REST):
            total += values.get(edge, 0.0)
            buckets.append((edge, total))
        yield stage, buckets, values.get(_SUM, 0.0)
