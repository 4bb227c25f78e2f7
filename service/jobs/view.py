"""What a job can make, an avatar of a photo or something of a finished avatar, and what an owner sees of it: the same
JSON in answers, lists and events, and faults as RFC 9457 problem objects.

What is made of a finished avatar is *derived*: it has no photo, belongs to the avatar and goes with it, and is kept by
its content, so that the same request for the same result is computed once. A further kind needs an entry here
with its settings, a program that computes it, as :mod:`service.jobs.archive_process` is, and its routes, on
:mod:`service.api.renders_and_exports`.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from service.errors import as_facts
from service.jobs.settings import Settings
from service.words import WORDS

FINAL = ("succeeded", "failed", "cancelled")
"""States that a job does not leave."""

STATES = ("queued", "running", *FINAL)


def job_json(row: sa.RowMapping | Mapping[str, Any]) -> dict[str, Any]:
    """State of a job, of a row of ``service.jobs.database.JOBS``."""
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
    warnings = json.loads(row["warnings"])
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
        "warnings": warnings,
        "warning_words": [WORDS["warnings"].get(code, code) for code in warnings],
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

TITLES = WORDS["titles"]
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


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of job.

    Attributes:
        name: as it is stored, logged and counted.
        place: below ``/v1``, and the name of its queue: a picture of some seconds does not wait for a head of minutes.
        artifact: what its result is called in names of artifacts and in links.
        file: name of the result as its process writes it and as it is given out.
        program, seconds, at_a_time: names of the settings with the module that computes it, the longest time of one,
            and how many one worker computes at the same time (0: none).
        derived: made of a finished avatar.
        looks: how many times as long as into other queues a worker waits between two looks into this one.
        slow: of a derived kind, what to say where it took too long; ``{seconds}`` is filled in.
    """

    name: str
    place: str
    artifact: str
    file: str
    program: str
    seconds: str
    at_a_time: str
    derived: bool = True
    looks: float = 1.0
    slow: str = ""

    def limits(self, settings: Settings) -> Settings:
        """Settings of the process that computes one: those of a job's, with the kind's program and deadline."""
        program, seconds = getattr(settings, self.program), getattr(settings, self.seconds)
        return dataclasses.replace(settings, program=program, job_seconds=seconds)

    def most(self, settings: Settings) -> int:
        """How many one worker computes at the same time."""
        return int(getattr(settings, self.at_a_time))


AVATAR = Kind(
    name="avatar", place="avatars", artifact="archive", file="archive.zip", program="program", seconds="job_seconds",
    at_a_time="jobs", derived=False, looks=0.25,
)  # fmt: skip

RENDER = Kind(
    name="render", place="renders", artifact="picture", file="picture.png", program="archive_program",
    seconds="render_seconds", at_a_time="renders",
    slow="rendering took more than {seconds:g} s; ask for a smaller picture",
)  # fmt: skip

EXPORT = Kind(
    name="export", place="exports", artifact="kit", file="kit.zip", program="archive_program",
    seconds="export_seconds", at_a_time="exports", looks=2.5,
    slow="making the kit took more than {seconds:g} s; make the avatar with smaller maps",
)  # fmt: skip

KINDS = {kind.name: kind for kind in (AVATAR, RENDER, EXPORT)}
"""All kinds by name."""
