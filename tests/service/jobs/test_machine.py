"""What a process may use of its machine, and the limits that it sets itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.machine import memory_bytes, processors

GIB = 1 << 30


def system(root: Path, cgroup: str, files: dict[str, str]) -> Path:
    content = {"proc/self/cgroup": cgroup, "proc/meminfo": f"MemTotal: {64 * GIB >> 10} kB\n", **files}
    for name, text in content.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize(
    ("cgroup", "files", "memory"),
    [
        ("0::/\n", {"sys/fs/cgroup/memory.max": f"{GIB}\n"}, GIB),
        ("0::/a/b\n", {"sys/fs/cgroup/a/b/memory.max": "max\n", "sys/fs/cgroup/a/memory.max": f"{2 * GIB}\n"}, 2 * GIB),
        ("0::/a\n", {"sys/fs/cgroup/a/memory.max": f"{3 * GIB}", "sys/fs/cgroup/memory.max": f"{GIB}"}, GIB),
        ("5:memory:/docker/x\n0::/\n", {"sys/fs/cgroup/memory/memory.limit_in_bytes": f"{GIB}\n"}, GIB),
        ("5:memory:/x\n", {"sys/fs/cgroup/memory/x/memory.limit_in_bytes": "9223372036854771712\n"}, 64 * GIB),
        ("0::/\n", {}, 64 * GIB),
        ("", {}, 64 * GIB),
    ],
)
def test_memory_is_the_tightest_limit_on_the_way_up(
    tmp_path: Path, cgroup: str, files: dict[str, str], memory: int
) -> None:
    assert memory_bytes(system(tmp_path, cgroup, files)) == memory


@pytest.mark.parametrize(
    ("cgroup", "files"),
    [
        ("0::/\n", {"sys/fs/cgroup/cpu.max": "50000 100000\n"}),
        ("0::/a\n", {"sys/fs/cgroup/a/cpu.max": "max 100000\n", "sys/fs/cgroup/cpu.max": "100000 100000\n"}),
        ("4:cpu,cpuacct:/x\n", {f"sys/fs/cgroup/cpu/x/cpu.cfs_{name}_us": "100000" for name in ("quota", "period")}),
    ],
)  # fmt: skip
def test_a_quota_of_one_processor_is_one(tmp_path: Path, cgroup: str, files: dict[str, str]) -> None:
    assert processors(system(tmp_path, cgroup, files)) == 1
