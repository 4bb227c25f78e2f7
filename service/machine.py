"""What this process may use of its machine: memory and processors.

A container sees the memory and the cores of its host; what it may use of them stands in the files of its control group
(cgroup), version 2 or 1, and the tightest group on the way up counts.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path("/")
"""Of the file system; tests put another one here."""

_NO_LIMIT = 1 << 60
"""What version 1 writes where there is no limit is about 2^63."""


def variable(name: str, environment: Mapping[str, str] = os.environ) -> str | None:
    """A setting from the environment. None: it is not there or empty, as compose files pass what nobody has set."""
    return environment.get(name) or None


def memory_bytes(root: Path = ROOT) -> int:
    """Bytes of memory that this process and all beside it in its container may use."""
    total = kib(root / "proc/meminfo", "MemTotal")
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if total is None else total << 10]
    for folder in _groups(root, "memory"):
        for name in ("memory.max", "memory.limit_in_bytes"):
            limit = _number(folder / name)
            if limit is not None and 0 < limit < _NO_LIMIT:
                limits.append(int(limit))
    return min(limits)


def processors(root: Path = ROOT) -> int:
    """Processors that this process may use, at least 1; a share of one is one."""
    counts = [float(len(os.sched_getaffinity(0)))]
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


def kib(path: Path, key: str) -> int | None:
    """The KiB that a file of /proc states for a key, such as ``VmHWM``; None where it does not."""
    words = fields(path).get(key, "").split()
    return int(words[0]) if words else None


def fields(path: Path) -> dict[str, str]:
    """``key : value`` lines of a file of /proc, the first of each key; empty where the system has no such file."""
    found: dict[str, str] = {}
    for line in _text(path).splitlines():
        key, _, value = line.partition(":")
        found.setdefault(key.strip(), value.strip())
    return found


def _number(path: Path) -> float | None:
    text = _text(path).strip()
    return float(text) if text.lstrip("-").isdigit() else None


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""
