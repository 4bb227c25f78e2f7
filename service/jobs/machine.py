"""What this process may use of its machine, and the limits that a job's process sets itself.

A container sees the memory and the cores of its host; what it may use of them stands in the files of its control group
(cgroup), version 2 or 1, and the tightest group on the way up counts.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import stat
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/")
"""Of the file system; tests put another one here."""

_NO_LIMIT = 1 << 60
"""What version 1 writes where there is no limit is about 2^63."""


def memory_bytes(root: Path = ROOT) -> int:
    """Bytes of memory that this process and all beside it in its container may use."""
    limits = [_physical(root)]
    for folder in _groups(root, "memory"):
        for name in ("memory.max", "memory.limit_in_bytes"):
            limit = _number(folder / name)
            if limit is not None and 0 < limit < _NO_LIMIT:
                limits.append(int(limit))
    return min(limits)


def processors(root: Path = ROOT) -> int:
    """Processors that this process may use, at least 1; a share of one is one."""
    counts = [float(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)]
    for folder in _groups(root, "cpu"):
        words = _text(folder / "cpu.max").split()
        if len(words) == 2 and words[0].isdigit():
            counts.append(int(words[0]) / int(words[1]))
        quota, period = _number(folder / "cpu.cfs_quota_us"), _number(folder / "cpu.cfs_period_us")
        if quota is not None and period and quota > 0:
            counts.append(quota / period)
    return max(1, math.ceil(min(counts)))


def _groups(root: Path, controller: str) -> Iterator[Path]:
    """Folders of this process's groups that may limit something, from its own up to the root."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        number, _, rest = line.partition(":")
        names, _, path = rest.partition(":")
        if number == "0" and not names:
            base = root / "sys/fs/cgroup"
        elif controller in names.split(","):
            base = root / "sys/fs/cgroup" / controller
        else:
            continue
        # In a container the path may be the host's, which is not there; its own group is then the root of the mount.
        parts = [part for part in path.split("/") if part not in ("", "..")]
        for depth in range(len(parts), -1, -1):
            yield base.joinpath(*parts[:depth])


def _physical(root: Path) -> int:
    for line in _text(root / "proc/meminfo").splitlines():
        if line.startswith("MemTotal:"):
            return int(line.split()[1]) << 10
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return 8 << 30


def _number(path: Path) -> float | None:
    text = _text(path).strip()
    return float(text) if text.lstrip("-").isdigit() else None


def _text(path: Path) -> str:
    try:
        return path.read_text("ascii")
    except (OSError, UnicodeError):
        return ""


_PR_SET_PDEATHSIG = 1
_OOM_SCORE = "500"
_M_MMAP_THRESHOLD = -3
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
    if sys.platform == "win32":
        return
    import resource

    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_CPU, int(seconds * (os.cpu_count() or 1)) + 60)
    if sys.platform != "linux":
        return
    if memory_mb:
        # RLIMIT_AS would count the address space that allocators and networks reserve and never use.
        _lower(resource.RLIMIT_DATA, memory_mb << 20)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as score:
        score.write(_OOM_SCORE)  # the system takes this process first, not the server
    end_with_parent(parent)


def end_with_parent(parent: int) -> None:
    """Have the system end this process together with the one that started it, where it is Linux."""
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        import ctypes

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
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        import ctypes

        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)


def end_with(pipe: int) -> None:
    """End this process when the other end of a pipe closes: for systems without a signal at the parent's death.

    Args:
        pipe: its file descriptor. Not a Python stream: a thread that reads one holds its lock while the interpreter
            ends, which aborts the process.
    """

    def wait() -> None:
        while os.read(pipe, 4096):
            pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


if sys.platform != "win32":

    def _lower(kind: int, value: int) -> None:
        import resource

        hard = resource.getrlimit(kind)[1]
        if hard != resource.RLIM_INFINITY:
            value = min(value, hard)
        resource.setrlimit(kind, (value, value))
