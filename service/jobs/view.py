"""A job as its owner sees it: the same JSON in answers, lists and events."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from service.jobs.kinds import KINDS, Kind

FINAL = ("succeeded", "failed", "cancelled")
"""States that a job does not leave."""

STATES = ("queued", "running", *FINAL)


def job_json(row: sa.RowMapping) -> dict[str, Any]:
    """State of a job.

    Args:
        row: a row of ``service.jobs.database.JOBS``.
    """
    kind = KINDS[row["kind"]]
    address = f"/v1/{kind.place}/{row['id']}"
    if kind.derived:
        return _derived_json(row, kind, address)
    done = row["state"] == "succeeded" and row["gone"] is None
    error = json.loads(row["error"]) if row["error"] else None
    return {
        "id": row["id"],
        "state": row["state"],
        "stage": row["stage"],
        "progress": round(float(row["progress"]), 4),
        "created_at": stamp(row["created_at"]),
        "started_at": stamp(row["started_at"]),
        "finished_at": stamp(row["finished_at"]),
        "expires_at": stamp(row["expires_at"]),
        "links": {
            "self": address,
            "events": f"{address}/events",
            "archive": f"{address}/archive.zip" if done else None,
            "files": f"{address}/files" if done else None,
            "photo": f"{address}/photo" if row["keep_photo"] and row["photo"] and row["gone"] is None else None,
        },
        "error": {**error, "instance": address} if error else None,
        "warnings": json.loads(row["warnings"]),
        "options": json.loads(row["options"]),
        "priority": row["priority"],
        "metadata": json.loads(row["metadata"]),
    }


def _derived_json(row: sa.RowMapping, kind: Kind, address: str) -> dict[str, Any]:
    done = row["state"] == "succeeded" and row["gone"] is None
    error = json.loads(row["error"]) if row["error"] else None
    times = {name: stamp(row[name]) for name in ("created_at", "started_at", "finished_at", "expires_at")}
    return {
        "id": row["id"],
        "state": row["state"],
        **times,
        "links": {
            "self": address,
            "avatar": f"/v1/avatars/{row['source']}",
            kind.artifact: f"{address}/{kind.file}" if done else None,
        },
        "error": {**error, "instance": address} if error else None,
        "request": json.loads(row["options"]).get("request", {}),
    }


def stamp(seconds: float | None) -> str | None:
    """RFC 3339 in UTC with milliseconds."""
    if seconds is None:
        return None
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
