"""Results of stages, kept in memory between the variants of one photo."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Kept:
    """Keeps what stages gave, and forgets what comes after a rule; ``service.stage_cache.Stages``."""

    def __init__(self) -> None:
        self._results: dict[str, Any] = {}

    def keep(self, name: str, make: Callable[[], T]) -> T:
        """The result of stage ``name``, made at most once."""
        if name not in self._results:
            self._results[name] = make()
        result: T = self._results[name]
        return result

    def copy(self) -> Kept:
        """Another that has the same results."""
        other = Kept()
        other._results.update(self._results)
        return other

    def forget(self, first: str) -> None:
        """Forget stage ``first`` and all that ran after it; nothing where it has not run."""
        names = list(self._results)
        for name in names[names.index(first) :] if first in names else []:
            del self._results[name]
