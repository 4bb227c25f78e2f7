"""A job before it is stored, and its first row."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from service.jobs.clock import now
from service.jobs.lookups import Row


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

    def __init__(self, row: Row) -> None:
        super().__init__("there is a job for this key")
        self.row = row
