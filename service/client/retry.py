"""When to ask again, and how long to wait before."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

from service.errors import UsageError

AGAIN = frozenset({408, 425, 429, 502, 503, 504, 507})
"""Statuses that say: not now. Other 5xx are bugs, which asking again only repeats."""


@dataclass(frozen=True)
class Retry:
    """Exponential back-off with full jitter (Brooker, "Exponential Backoff And Jitter", AWS Architecture Blog, 2015).

    Attributes:
        attempts: requests in all, the first one counted.
        first_s: bound of the first pause.
        longest_s: bound of any pause that the server did not ask for.
        patience_s: the pauses of one request, added up, never exceed this; a server that asks for more is given up.
        silence_s: the same for the pauses since the server last answered at all.
        sleep: how to pause.
        draw: uniform random number in [0, 1).

    Raises:
        UsageError: a value is out of range.
    """

    attempts: int = 8
    first_s: float = 0.5
    longest_s: float = 30.0
    patience_s: float = 300.0
    silence_s: float = 300.0
    sleep: Callable[[float], None] = field(default=time.sleep, repr=False)
    draw: Callable[[], float] = field(default=random.random, repr=False)

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise UsageError(f"attempts is {self.attempts}; at least one is needed", field="attempts")
        for name in ("first_s", "longest_s", "patience_s", "silence_s"):
            if not 0 <= getattr(self, name) < math.inf:
                raise UsageError(f"{name} is {getattr(self, name)}; it has to be 0 or more seconds", field=name)

    def start(self) -> Pauses:
        """The pauses of one request."""
        return Pauses(self)


class Pauses:
    """Counts what one request has spent."""

    def __init__(self, policy: Retry) -> None:
        self._policy = policy
        self._tries = 0
        self._paused = self._silent = 0.0

    def pause(self, retry_after: float | None = None, *, silent: bool = False) -> bool:
        """Wait before the next attempt; False, at once, where there should be none.

        Args:
            retry_after: seconds that the server asked for: a lower bound, on which the jitter comes on top.
            silent: there was no answer.
        """
        policy = self._policy
        self._tries += 1
        if self._tries >= policy.attempts:
            return False
        bound = min(policy.longest_s, policy.first_s * 2.0 ** min(self._tries - 1, 60))
        jitter = policy.draw() * bound
        seconds = jitter if retry_after is None else retry_after + min(jitter, 0.1 * retry_after + policy.first_s)
        self._paused += seconds
        self._silent = self._silent + seconds if silent else 0.0
        if self._paused > policy.patience_s or self._silent > policy.silence_s:
            return False
        policy.sleep(seconds)
        return True


def retry_after_s(value: str | None, now: datetime | None = None) -> float | None:
    """Seconds of a ``Retry-After`` header (RFC 9110, section 10.2.3): a number or a date; None for anything else."""
    if value is None:
        return None
    text = value.strip()
    if text.isascii() and text.isdigit() and len(text) <= 9:
        return float(text)
    try:
        when = parsedate_to_datetime(text)
    except ValueError:
        return None
    if when.tzinfo is None:  # the obsolete "-0000": it is UTC all the same
        when = when.replace(tzinfo=UTC)
    return max(0.0, (when - (now or datetime.now(UTC))).total_seconds())
