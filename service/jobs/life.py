"""One line of the log for each turn in the life of a job: accepted, started, stage, ended.

Every line has ``event``, ``job``, ``tenant`` and ``kind``; none says anything of the photo.
"""

from __future__ import annotations

import json
import logging
from typing import Any

import sqlalchemy as sa

from service.jobs.clock import now

Row = sa.RowMapping

log = logging.getLogger("service.jobs.life")


def accepted(row: Row) -> None:
    """A job was stored and waits."""
    _tell("accepted", row, priority=row["priority"], turn=row["turn"], bytes=row["photo_bytes"])


def started(row: Row) -> None:
    """A worker took a job up, for the first time or again."""
    _tell("started", row, waited_s=round((row["started_at"] or now()) - row["created_at"], 3))


def stage(row: Row, name: str) -> None:
    """A job has come to its next stage."""
    began = row["started_at"] or row["created_at"]
    _tell("stage", row, stage=name, after_s=round(now() - began, 3))


def ended(row: Row) -> None:
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
    _tell("ended", row, level, **facts)


def _tell(event: str, row: Row, level: int = logging.INFO, **facts: Any) -> None:
    who = {"event": event, "job": row["id"], "tenant": row["tenant"], "kind": row["kind"]}
    log.log(level, "job %s", event, extra=who | facts)
