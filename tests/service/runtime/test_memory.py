from __future__ import annotations

import subprocess
import sys

import pytest

from service.runtime import memory
from service.runtime.memory import prompt_release

PROGRAM = """
import contextlib, sys
import numpy as np
from service.runtime.memory import prompt_release, release

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096

for _ in range(3):
    np.ones(20 << 20, np.uint8)  # freed at once: lets the C library get used to blocks of that size
before = resident()
with prompt_release() if sys.argv[1] == "prompt" else contextlib.nullcontext():
    blocks, small = [], []
    for _ in range(10):
        blocks.append(np.ones(20 << 20, np.uint8))
        small.append(np.ones(100_000, np.uint8))
    blocks.clear()
    if sys.argv[1] == "later":
        release()
    print(resident() - before)
"""


@pytest.mark.skipif(memory._glibc() is None, reason="the C library is not glibc")
def test_freed_blocks_go_back_at_once_or_when_told() -> None:
    """Left alone, the C library keeps 200 MB for later; if it ever does not, the measure can go."""
    kept = {}
    for way in ("prompt", "later", "plain"):
        done = subprocess.run([sys.executable, "-c", PROGRAM, way], capture_output=True, text=True, check=True)
        kept[way] = int(done.stdout)
    assert max(kept["prompt"], kept["later"]) < 16 << 20 < kept["plain"]


def test_other_c_libraries_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    memory._glibc.cache_clear()
    try:
        with prompt_release():
            assert memory._glibc() is None
            memory.release()
    finally:
        memory._glibc.cache_clear()


def test_an_error_within_passes_through() -> None:
    with pytest.raises(ZeroDivisionError), prompt_release():
        _ = 1 / 0
