"""What an owner sees: a job as the same JSON in answers, lists and events, and faults as RFC 9457 problem objects."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from service.errors import as_facts
from service.jobs.kinds import KINDS

FINAL = ("succeeded", "failed", "cancelled")
"""States that a job does not leave."""

STATES = ("queued", "running", *FINAL)


def job_json(row: sa.RowMapping | Mapping[str, Any]) -> dict[str, Any]:
    """State of a job.

    Args:
        row: a row of ``service.jobs.database.JOBS``.
    """
    kind = KINDS[row["kind"]]
    address = f"/v1/{kind.place}/{row['id']}"
    done = row["state"] == "succeeded" and row["gone"] is None
    error = json.loads(row["error"]) if row["error"] else None
    options = json.loads(row["options"])
    common = {
        "id": row["id"],
        "state": row["state"],
        **{name: stamp(row[name]) for name in ("created_at", "started_at", "finished_at", "expires_at")},
        "error": {**error, "instance": address} if error else None,
    }
    if kind.derived:
        result = f"{address}/{kind.file}" if done else None
        links = {"self": address, "avatar": f"/v1/avatars/{row['source']}", kind.artifact: result}
        return {**common, "links": links, "request": options.get("request", {})}
    return {
        **common,
        "stage": row["stage"],
        "progress": round(float(row["progress"]), 4),
        "links": {
            "self": address,
            "events": f"{address}/events",
            "archive": f"{address}/archive.zip" if done else None,
            "files": f"{address}/files" if done else None,
            "photo": f"{address}/photo" if row["keep_photo"] and row["photo"] and row["gone"] is None else None,
        },
        "warnings": json.loads(row["warnings"]),
        "options": options,
        "priority": row["priority"],
        "metadata": json.loads(row["metadata"]),
    }


def stamp(seconds: float | None) -> str | None:
    """RFC 3339 in UTC with milliseconds."""
    if seconds is None:
        return None
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


_INTERNAL = "The server could not finish this; the fault is on its side and was logged."

TITLES = {
    "no-face": "No face in the photo",
    "multiple-faces": "Several faces in the photo",
    "face-too-small": "The face is too small",
    "face-cut-off": "The face is cut off",
    "fit-failed": "The head does not fit the face",
    "unsupported-format": "Not a photo format that is accepted",
    "corrupt-image": "The image is damaged",
    "empty-file": "The file is empty",
    "too-large": "The upload is too large",
    "too-many-pixels": "The image has too many pixels",
    "too-small": "The image is too small",
    "bad-aspect": "The image is too long and narrow",
    "animated": "The image has several frames",
    "too-complex": "Decoding the image costs too much",
    "bad-archive": "Not an archive that can be used",
    "bad-mesh": "Not a mesh that can be used",
    "usage": "An option is not possible",
    "model-corrupt": "A data file of the server is damaged",
    "numeric-error": "The computation failed",
    "output": "The result could not be stored",
    "crashed": "The computation crashed",
    "out-of-memory": "The computation needs more memory than is allowed",
    "out-of-time": "The computation takes more time than is allowed",
    "internal": "A fault of the server",
}
"""Title of each code of ``service.errors`` that a job can end with."""


def problem(code: str, status: int, detail: str, **extra: Any) -> dict[str, Any]:
    """A problem object; ``type`` is an address on this server that explains the code."""
    return {
        **extra,
        "type": f"/problems/{code}",
        "title": TITLES.get(code, code.replace("-", " ").capitalize()),
        "status": status,
        "detail": detail,
        "code": code,
    }


def from_error(error: BaseException) -> dict[str, Any]:
    """The problem object of a fault; as :func:`from_facts`."""
    return from_facts(as_facts(error))


def from_facts(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The problem object of :func:`service.errors.as_facts`: words of 4xx as they are, those of 5xx replaced."""
    extra = dict(facts)
    code, status, message = (extra.pop(name) for name in ("code", "status", "message"))
    if status >= 500 and code not in ("crashed", "out-of-memory", "out-of-time"):
        return problem(code, status, _INTERNAL)
    field = extra.pop("field", None)
    if field is not None:
        extra["pointer"] = f"/{field}"
    return problem(code, status, message, **extra)
