"""Groups of processes with a limit of memory of the kernel's (cgroups, version 1 or 2), as containers are."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

VERSION_1 = Path("/sys/fs/cgroup/memory")
VERSION_2 = Path("/sys/fs/cgroup")


class Group:
    """One group.

    Args:
        limit: bytes of memory that its processes may have together.

    Raises:
        OSError: none can be made here.
    """

    def __init__(self, limit: int) -> None:
        self._old = VERSION_1.is_dir()
        self._folder = (VERSION_1 if self._old else VERSION_2) / f"avatarme-test-{os.getpid()}-{limit}"
        if not self._old:
            (VERSION_2 / "cgroup.subtree_control").write_text("+memory")
        self._folder.mkdir()
        if self._old:
            (self._folder / "memory.limit_in_bytes").write_text(str(limit))
        else:
            (self._folder / "memory.max").write_text(str(limit))
            with contextlib.suppress(FileNotFoundError):  # where the kernel counts no swap
                (self._folder / "memory.swap.max").write_text("0")

    def command(self, command: list[str]) -> list[str]:
        """The same command, with its process and all that it starts in the group."""
        return ["sh", "-c", 'echo $$ > "$0" && exec "$@"', str(self._folder / "cgroup.procs"), *command]

    def kills(self) -> int:
        """How many processes the kernel has killed for their memory."""
        text = (self._folder / ("memory.oom_control" if self._old else "memory.events")).read_text()
        return int(dict(line.split() for line in text.splitlines())["oom_kill"])

    def most(self) -> int:
        """The most bytes that were used at a time, the page cache of its files included."""
        return int((self._folder / ("memory.max_usage_in_bytes" if self._old else "memory.peak")).read_text())

    def close(self) -> None:
        """Remove it, as soon as its processes are gone."""
        for _ in range(100):
            with contextlib.suppress(OSError):
                self._folder.rmdir()
                return
            time.sleep(0.1)


def group(limit: int) -> Iterator[Group]:
    """For a fixture; the test is skipped, with the reason, where no group can be made."""
    try:
        made = Group(limit)
    except OSError as error:
        pytest.skip(f"no memory cgroup can be made here; it needs root and a hierarchy that can be written: {error}")
    yield made
    made.close()
