from __future__ import annotations

import time

import pytest

from service.jobs.clock import now


@pytest.mark.parametrize("jump", [86400.0, -86400.0])
def test_a_clock_that_is_set_does_not_move_deadlines(monkeypatch: pytest.MonkeyPatch, jump: float) -> None:
    """Otherwise a day forward would erase all results, and a day back keep them a day longer."""
    before, wall = now(), time.time()
    assert before == pytest.approx(wall, abs=60)
    monkeypatch.setattr(time, "time", lambda: wall + jump)
    assert 0 <= now() - before < 60
