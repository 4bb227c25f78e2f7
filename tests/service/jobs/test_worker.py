"""A worker whose data files are damaged, and whole again."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.jobs import worker as worker_module
from service.jobs import workflow
from service.jobs.database import TEMPORARY_FAILURE
from service.jobs.settings import Settings
from service.jobs.view import problem
from service.jobs.worker import Worker
from tests.service.databases import lay_out
from tests.service.jobs.conftest import Bench


class Quit(Exception):
    """In place of the end of the process."""


class Watched:
    """A worker whose data files are what a test says; what it does is written down."""

    def __init__(self, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.faults: list[str] = []
        self.launched = 0
        monkeypatch.setattr(worker_module, "faults", lambda settings: list(self.faults))
        monkeypatch.setattr(workflow, "launch", self._launch)
        monkeypatch.setattr(os, "_exit", self._exit)
        lay_out(data)
        self.worker = Worker(Settings(data=data, program="tests.support.toy_job"))

    def start(self) -> None:
        """As at the start of its process, without the loop."""
        self.worker._check()
        if self.worker._fault is None:
            self.worker._launch()

    def _launch(self, settings: Settings, *kinds: object) -> None:
        self.launched += 1

    def _exit(self, status: int) -> None:
        raise Quit(status)


@pytest.fixture
def watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    made = Watched(tmp_path / "data", monkeypatch)
    yield made
    made.worker.runner.stop()
    made.worker._janitor._queue.client.destroy()
    made.worker.engine.dispose()


def test_a_worker_begins_to_work_when_its_data_files_are_whole_again(watched: Watched) -> None:
    """Without it somebody would have to restart the worker after copying the weights once more."""
    watched.faults = ["psi.onnx was changed"]
    watched.start()
    watched.worker.recheck()
    assert (watched.worker._ready, watched.launched) == (False, 0)
    watched.faults = []
    watched.worker.recheck()
    watched.worker.recheck()
    assert (watched.worker._ready, watched.worker._fault, watched.launched) == (True, None, 1)


def test_a_worker_that_works_looks_only_when_a_job_says_that_a_file_is_damaged(watched: Watched) -> None:
    watched.start()
    watched.faults = ["psi.onnx was changed"]
    watched.worker.recheck()
    assert watched.worker._ready
    watched.worker.runner.doubt.set()
    with pytest.raises(Quit, match=str(TEMPORARY_FAILURE)):
        watched.worker.recheck()


def test_a_worker_whose_files_turn_out_to_be_whole_goes_on(watched: Watched) -> None:
    watched.start()
    watched.worker.runner.doubt.set()
    watched.worker.recheck()
    assert (watched.worker._ready, watched.launched) == (True, 1)
    assert not watched.worker.runner.doubt.is_set()


def test_the_end_of_a_job_raises_the_doubt(bench: Bench) -> None:
    for code, doubt in (("no-face", False), ("model-corrupt", True)):
        job = bench.add()
        bench.runner.publish(job, {"kind": "problem", "problem": problem(code, 500, "")})
        assert bench.runner.doubt.is_set() is doubt
