"""What a process does to itself."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = """
import os, sys, threading
from service.jobs.limits import give_back_memory
from service.jobs.process import resident_mb
if sys.argv[1] == "yes":
    give_back_memory()

def work():
    for _ in range(3):
        block = b"x" * (12 << 20)
        together.wait()
        del block
        together.wait()

before = resident_mb(os.getpid())
together = threading.Barrier(8)
threads = [threading.Thread(target=work) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(resident_mb(os.getpid()) - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the allocator is another one")
def test_large_blocks_are_given_back() -> None:
    """Photos pass through many threads of the server; without this each of them keeps the room of one or two."""
    command = [sys.executable, "-c", _PROGRAM, "yes"]
    kept = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert kept < 20
