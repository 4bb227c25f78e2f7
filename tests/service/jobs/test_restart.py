"""Killing, freezing and stopping a whole service."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import httpx
import pytest

from tests.support.server import Server, post, small_photo, wait_for
from tests.support.toy_job import SECONDS


@pytest.mark.slow
def test_a_signal_ends_it_and_the_job_goes_on_after_the_next_start(tmp_path: Path) -> None:
    server = Server(tmp_path / "data", {}, {SECONDS: "0.7"})
    server.start()
    with httpx.Client(base_url=server.url, timeout=30) as client:
        job = post(client, small_photo(1)).json()["id"]
        with client.stream("GET", f"/v1/avatars/{job}/events") as events:
            lines = events.iter_lines()
            while "running" not in next(lines):
                pass
            processes = server.processes()
            begin = time.monotonic()
            assert server.process is not None
            server.process.send_signal(signal.SIGTERM)
            assert "succeeded" not in "".join(lines), "the stream ends although the job has not"
        assert server.process.wait(45) == 0
        assert time.monotonic() - begin < 45
        assert not [process for process in processes if _runs(process)]
        server.start()
        assert wait_for(client, job)["state"] == "succeeded"
    server.stop()


def _runs(process: int) -> bool:
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
