from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

import pytest

from service.jobs.strays import SEEN, STRAY, Strays

if TYPE_CHECKING:
    from tests.service.jobs.conftest import Bench


def test_uploads_that_became_no_job_go_after_an_hour(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    strays = Strays(bench.settings, bench.store, bench.artifacts)
    folder = bench.artifacts.folder
    assert folder is not None
    young, old = folder / ("c" * 32), folder / ("d" * 32)
    bench.settings.incoming.mkdir()
    part = bench.settings.incoming / "x.part"
    for path in (young, old):
        path.mkdir()
        (path / f"photo-{'0' * 64}.bin").write_bytes(b"x")
    part.write_bytes(b"x")
    for path in (old, part):
        os.utime(path, (time.time() - 2 * STRAY,) * 2)
    job = bench.add()
    strays.sweep()
    assert old.exists(), "a clock that was set by a day makes everything old"
    assert part.exists()
    later = time.monotonic() + SEEN
    monkeypatch.setattr(time, "monotonic", lambda: later)
    strays.sweep()
    assert young.exists()
    assert not old.exists()
    assert not part.exists()
    assert bench.artifacts.names(job)
