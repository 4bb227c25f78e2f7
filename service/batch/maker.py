"""What makes an archive of a photo: a process here, or a server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from service.errors import AvatarError

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done, in [0, 1]."""


@dataclass(frozen=True)
class Order:
    """One photo to be made.

    Attributes:
        photo: the file.
        name: its name in the report.
        sha256: its hex digest.
        options: what was asked for, JSON values; what is not named has its default.
        attempt: counts from 1.
        target: where the archive goes; the folder is there.
    """

    photo: Path
    name: str
    sha256: str
    options: Mapping[str, Any]
    attempt: int
    target: Path


class Maker(Protocol):
    """Makes archives; threads share it."""

    def make(self, order: Order, progress: Progress) -> list[str]:
        """Write a whole, checked archive to ``order.target``, or nothing. Returns the warnings.

        Raises:
            AvatarError: why there is none.
            Stopped: :meth:`stop` was called.
            Hopeless: no photo will get through, this one or another.
        """
        ...

    def stop(self) -> None:
        """Let every ``make`` end soon, with :class:`Stopped`."""
        ...

    def close(self) -> None:
        """Called once, after the last ``make``."""
        ...


class Stopped(Exception):
    """The run is to end."""


class Hopeless(Exception):
    """Nothing can be made any more, whatever the photo; ``error`` says why."""

    def __init__(self, error: AvatarError) -> None:
        super().__init__(error.message)
        self.error = error
