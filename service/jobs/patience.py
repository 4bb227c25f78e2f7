"""Waiting for a database or a disk that fails for a while."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from typing import TypeVar

import sqlalchemy as sa

T = TypeVar("T")

log = logging.getLogger(__name__)

TEMPORARY_FAILURE = 75
"""Exit status (EX_TEMPFAIL) of a worker that cannot reach its database or disk; it is started again."""

PATIENCE = 60.0
"""Seconds for which a step waits for its database or disk before the worker gives up."""


def patient(call: Callable[[], T]) -> T:
    """Call again and again while the database or the disk fails; after ``PATIENCE`` end this process.

    An exception would be recorded as the result of the step, and the job would fail for what is not its fault. A new
    process takes the step up again.
    """
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return call()
        except (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError, OSError) as error:
            log.warning("waiting for database or disk: %s", error)
            if time.monotonic() > deadline:
                log.critical("this worker cannot reach its database or disk and ends")
                os._exit(TEMPORARY_FAILURE)
        time.sleep(0.5)
