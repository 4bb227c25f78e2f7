"""Where the pipeline leaves the result of a finished stage, so that a run that was cut off can go on from there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

T = TypeVar("T")


class StageCache(Protocol):
    """Results of stages; ``service.jobs.stage_files`` keeps them on disk."""

    def get_or_compute(self, name: str, make: Callable[[], T]) -> T:
        """The result of stage ``name``: the kept one where there is one, else that of ``make``, which is then kept.

        What comes back is equal to the last bit, whether it was kept or made. A result is a dataclass of the pipeline,
        an array, a number, a string, None, or a tuple or dictionary of such.
        """
        ...


class NoCache:
    """Keeps nothing: every stage is computed."""

    def get_or_compute(self, name: str, make: Callable[[], T]) -> T:
        """What ``make`` returns."""
        return make()
