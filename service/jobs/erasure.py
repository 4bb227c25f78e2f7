"""Letting go of a job and of all that was made from it."""

from __future__ import annotations

from service.jobs.clock import now
from service.jobs.database import JOBS
from service.jobs.queue import Queue
from service.jobs.store import Row, Store, workflows


def let_go(store: Store, queue: Queue, row: Row, reason: str, expires: float | None = None) -> list[str]:
    """Cancel a job that is unfinished, forget the result of one that has ended; the same for its pictures.

    Files are removed by whoever sweeps afterwards.

    Args:
        store: the jobs.
        queue: their workflows.
        row: of the job.
        reason: "erased" or "expired".
        expires: until when a cancelled job says that it was; None for now.

    Returns:
        Ids of the jobs whose files may go.
    """
    pictures = store.where(JOBS.c.source == row["id"], JOBS.c.gone.is_(None)) if row["kind"] == "avatar" else []
    for one in (*pictures, row):
        if store.cancel(one["id"], now() if expires is None else expires):
            queue.cancel(one["workflow"])
        elif one["gone"] is None:
            store.depart(one["id"], reason)
            queue.delete(workflows(one))  # results of steps name files by their hashes
    return [one["id"] for one in (*pictures, row)]
