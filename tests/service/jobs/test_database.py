"""The clock of the service, and its locks."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from service.errors import UsageError
from service.jobs.database import FileLock, now


@pytest.mark.parametrize("jump", [86400.0, -86400.0])
def test_a_clock_that_is_set_does_not_move_deadlines(monkeypatch: pytest.MonkeyPatch, jump: float) -> None:
    """Otherwise a day forward would erase all results, and a day back keep them a day longer."""
    before, wall = now(), time.time()
    assert before == pytest.approx(wall, abs=60)
    monkeypatch.setattr(time, "time", lambda: wall + jump)
    assert 0 <= now() - before < 60


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
