"""Where the pipeline leaves the result of a finished stage, so that a run that was cut off can go on from there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class StageCache(Protocol):
    """Results of stages; ``service.jobs.stage_files`` keeps them on disk."""

    def get_or_compute(self, name: str, make: Callable[[], T], on: Sequence[Any] = ()) -> T:
        """The result of stage ``name``: the kept one where there is one, else that of ``make``, which is then kept.

        ``on`` are JSON values that it depends on beside photo, program and the options that no correction changes.

        What comes back is equal to the last bit, whether it was kept or made. A result is a dataclass of the pipeline,
        an array, a number, a string, None, or a tuple or dictionary of such.
        """
        ...


class NoCache:
    """Keeps nothing: every stage is computed."""

    def get_or_compute(self, name: str, make: Callable[[], T], on: Sequence[Any] = ()) -> T:
        """What ``make`` returns."""
        return make()


@dataclass(frozen=True)
class Depending:
    """Stages that all depend on some values more."""

    stages: StageCache
    also: tuple[Any, ...]

    def get_or_compute(self, name: str, make: Callable[[], T], on: Sequence[Any] = ()) -> T:
        """As of :class:`StageCache`."""
        return self.stages.get_or_compute(name, make, (*self.also, *on))
