"""What an avatar would be if nothing of the photo's own detail were brought onto its map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from service.archive.avatar import Avatar
from service.options import Options
from service.reflectance.reflectance import make_reflectance
from service.reflectance.subject import Subject
from service.runtime.networks import choose_engine

T = TypeVar("T")


class Kept:
    """Keeps the results of some stages in memory (``service.stage_cache.Stages``)."""

    def __init__(self, *names: str) -> None:
        self._names = names
        self._results: dict[str, Any] = {}

    def keep(self, name: str, make: Callable[[], T]) -> T:
        """The kept result, else that of ``make``."""
        if name in self._results:
            kept: T = self._results[name]
            return kept
        result = make()
        if name in self._names:
            self._results[name] = result
        return result


def without_own(avatar: Avatar, kept: Kept) -> Avatar:
    """The same avatar with the diffuse albedo that super-resolution alone leads to.

    Args:
        avatar: made with the standard options.
        kept: stages of its making; has the enlarged texture.
    """
    options = Options(maps=("diffuse_albedo",))
    made = make_reflectance(
        avatar.texture.texture,
        Subject.in_photo(avatar.head, avatar.fit, avatar.texture),
        options.plan(),
        options.map_size,
        choose_engine(options.runtime, precision=options.level.precision),
        seed=avatar.seed,
        detail=options.detail,
        stages=kept,
    )
    return replace(avatar, reflectance=made)
