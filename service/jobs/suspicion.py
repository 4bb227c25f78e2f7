"""A job that seems to take its whole worker along rests before it is tried again, which tells whether it does."""

from __future__ import annotations

import logging
import threading
import time

from service.jobs.patience import patient
from service.jobs.store import Store
from service.jobs.view import FINAL
from service.jobs.watching import LOOK

log = logging.getLogger(__name__)

LOSSES = 10
"""How often in a row its whole worker may be lost with a job, without a stage finished in between, before it fails.

Somebody who kills the worker now and then meets other jobs, or later stages of this one. A job that takes the worker
along each time, as where a container is ended as a whole for its memory, must not do so for ever.
"""

SUSPECTED = 3
REST, LONGEST_REST = 4.0, 60.0
"""After so many losses in a row a job rests before it is tried again: so many seconds, twice as many each time.

It is a test of the suspicion. If the worker is lost while the job rests, something else takes it along, and what was
lost before counts no more.
"""


def rest(store: Store, job: str, stopping: threading.Event) -> None:
    """Let a job rest that is suspected, unless the worker was lost while it did.

    Args:
        store: the jobs.
        job: which.
        stopping: set when the worker ends.
    """
    row = patient(lambda: store.get(job))
    if row is None or not (row["resting"] or SUSPECTED <= row["losses"] < LOSSES):
        return
    if row["resting"]:
        log.warning("a worker was lost while a job that was suspected of it rested", extra={"job": job})
        patient(lambda: store.set(job, resting=0, losses=0))
        return
    patient(lambda: store.set(job, resting=1))
    until = time.monotonic() + min(REST * 2 ** (row["losses"] - SUSPECTED), LONGEST_REST)
    while time.monotonic() < until and not stopping.is_set() and _wanted(store, job):
        stopping.wait(min(LOOK, max(until - time.monotonic(), 0.0)))
    patient(lambda: store.set(job, resting=0))


def _wanted(store: Store, job: str) -> bool:
    row = patient(lambda: store.get(job))
    return row is not None and row["state"] not in FINAL
