"""Workers of a batch that are killed, frozen and without their Postgres for a while."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.batch_chaos import run
from tests.support.postgres import find_programs


@pytest.mark.slow
@pytest.mark.skipif(find_programs() is None, reason="Postgres is not installed (apt-get install postgresql)")
def test_nothing_of_a_batch_is_lost_with_several_workers_on_postgres(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each photo is in the report once, with the bytes of a run that nobody disturbs."""
    for name in ("AWS_ENDPOINT_URL", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_DEFAULT_REGION"):
        monkeypatch.setenv(name, "")  # they are as before afterwards
    folder: Path = tmp_path_factory.mktemp("chaos")
    found = run(folder, 200, 6, 3.0, None, folder)
    assert found["well"], found
