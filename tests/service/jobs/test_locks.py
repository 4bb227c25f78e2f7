"""One process for each name."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from service.errors import UsageError
from service.jobs.locks import FileLock


def test_a_name_is_one_process_and_free_after_it(tmp_path: Path) -> None:
    """Two workers of one name would take each other's jobs for their own and run them twice."""
    first = FileLock(tmp_path / "data", "worker-w1")
    with pytest.raises(UsageError, match="in use by another worker-w1"):
        FileLock(tmp_path / "data", "worker-w1")
    other = FileLock(tmp_path / "data", "worker-w2")
    first.release()
    again = FileLock(tmp_path / "data", "worker-w1")
    for lock in (again, other):
        lock.release()


def test_whoever_waits_gets_it_when_it_is_free_or_says_so(tmp_path: Path) -> None:
    held = FileLock(tmp_path, "tables")
    with pytest.raises(UsageError, match="in use"):
        FileLock(tmp_path, "tables", patience=0.0)
    threading.Timer(0.3, held.release).start()
    begin = time.monotonic()
    FileLock(tmp_path, "tables", patience=60.0).release()
    assert time.monotonic() - begin >= 0.25
