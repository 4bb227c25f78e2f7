"""Letting jobs in and letting go of them, as the routes of avatars and of pictures both do."""

from __future__ import annotations

import contextlib
from typing import Any

from service.api.context import Context
from service.api.keys import Tenant
from service.api.problems import ProblemError, not_found
from service.jobs.admission import Bounds, NoRoom
from service.jobs.database import now
from service.jobs.erasure import checkpoint, let_go


def bounds_of(context: Context, tenant: Tenant) -> Bounds:
    """How much of a tenant is let in."""
    most = tenant.max_unfinished or context.settings.max_unfinished
    return Bounds(queued=context.settings.max_queued, unfinished=most, per_day=tenant.per_day)


def no_room(full: NoRoom) -> ProblemError:
    """The problem of a job that was not let in."""
    pause = "30" if full.kind == "queue-full" else "3600" if "per_day" in full.facts else "10"
    facts: dict[str, Any] = dict(full.facts)
    return ProblemError(full.kind, 429, headers={"Retry-After": pause}, **facts)


def erase(context: Context, job: str, tenant: Tenant, kind: str) -> None:
    """Cancel a tenant's job that is unfinished, erase one that has ended; with the pictures made from it.

    Raises:
        ProblemError: there is no such job, or it belongs to somebody else.
    """
    row = context.store.get(job) if len(job) == 32 else None
    if row is None or row["tenant"] != tenant.name or row["kind"] != kind:
        raise not_found()
    expires = now() + context.settings.result_hours * 3600
    for one in let_go(context.store, context.queue, row, "erased", expires):
        sweep(context, one)
    checkpoint(context.engine)


def sweep(context: Context, job: str) -> None:
    """Remove the files of a job as far as the store lets; a worker erases the rest, also of one that still writes."""
    with contextlib.suppress(OSError):
        context.artifacts.sweep(job, set())
