"""Where the pipeline leaves the result of a finished stage, so that a run that was cut off can go on from there.

A result is found by all that its stage was given, so a stage cannot serve what was made of something else. That holds
as long as it is a function of a module: what it uses, it is given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar, TypeVarTuple

T = TypeVar("T")
Given = TypeVarTuple("Given")


class Loaded:
    """Base of what is loaded from the program's own files: for a stage that is given it, its type says all of it."""


class StageCache(Protocol):
    """Results of stages; ``service.jobs.stage_files`` keeps them on disk."""

    def get_or_compute(self, name: str, make: Callable[[*Given], T], *given: *Given) -> T:
        """The result of stage ``name``: the kept one where the stage was given the same before, else ``make(*given)``.

        What comes back is equal to the last bit, whether it was kept or made. A result is a dataclass of the pipeline,
        an array, a number, a string, None, or a tuple or dictionary of such; what is given may also be bytes, a path,
        or :class:`Loaded`.
        """
        ...


class NoCache:
    """Keeps nothing: every stage is computed."""

    def get_or_compute(self, name: str, make: Callable[[*Given], T], *given: *Given) -> T:
        """What ``make`` returns."""
        return make(*given)
