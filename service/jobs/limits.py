"""The limits that a job's process sets itself, and what else a process of the server arranges with its system."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import stat
from pathlib import Path

from service.photo.wire import lower_limits

_PR_SET_PDEATHSIG = 1
_OOM_SCORE = "500"
_LARGE = 1 << 20


def limit_self(memory_mb: int, seconds: float, niceness: int, parent: int) -> None:
    """Apply the limits.

    Args:
        memory_mb: most private writable memory in MiB, 0 for none; an allocation beyond it raises MemoryError.
        seconds: processor time per core after which the system ends the process, in case that nobody else does.
        niceness: to add.
        parent: process to end with.
    """
    with contextlib.suppress(OSError):
        os.nice(niceness)
    lower_limits(CORE=0, CPU=int(seconds * (os.cpu_count() or 1)) + 60)
    if memory_mb:
        # RLIMIT_AS would count the address space that allocators and networks reserve and never use.
        lower_limits(DATA=memory_mb << 20)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as score:
        score.write(_OOM_SCORE)  # the system takes this process first, not the server
    end_with_parent(parent)


def end_with_parent(parent: int) -> None:
    """Have the system end this process together with the one that started it."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the line above
        os._exit(1)


def keep_private(folder: Path) -> None:
    """Let nobody but this process's user read what it writes from now on, nor what lies in a folder already.

    Args:
        folder: made where it is missing.
    """
    os.umask(0o077)
    folder.mkdir(parents=True, exist_ok=True)
    for place, _, files in os.walk(folder):
        for path in (Path(place), *(Path(place, name) for name in files)):
            with contextlib.suppress(OSError):  # somebody else's, or gone meanwhile
                mode = path.lstat().st_mode
                if mode & 0o077 and not stat.S_ISLNK(mode):
                    path.chmod(stat.S_IMODE(mode) & 0o700)


def give_back_memory() -> None:
    """Have large blocks returned to the system as soon as they are free, where the allocator is glibc's.

    It would raise the size from which it does so with every photo that passes through, and then keep what was freed, in
    a heap of its own for each thread.
    """
    from service.runtime.sessions import MMAP_THRESHOLD, glibc

    libc = glibc()
    if libc is not None:
        libc.mallopt(MMAP_THRESHOLD, _LARGE)
