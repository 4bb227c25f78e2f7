"""Time that does not jump."""

from __future__ import annotations

import time

_WALL = time.time()
_STEADY = time.monotonic()


def now() -> float:
    """Seconds since 1970 by the clock as it stood when this process started, counted on by the monotonic clock.

    Somebody who sets the machine's clock a day forward thereby neither expires results nor ends jobs.
    """
    return _WALL + (time.monotonic() - _STEADY)
