"""A worker whose data files are damaged, and whole again."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from service.jobs import worker as worker_module
from service.jobs import workflow
from service.jobs.database import TEMPORARY_FAILURE, WORKERS
from service.jobs.settings import Settings
from service.jobs.view import problem
from service.jobs.worker import LOOKS_APART, Worker
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


def test_a_worker_begins_to_work_when_its_data_files_are_whole_again(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it somebody would have to restart the worker after copying the weights once more."""
    watched.faults, told = ["psi.onnx was changed"], []
    stopping = watched.worker.runner.stopping

    def wait(seconds: float) -> bool:
        with watched.worker.engine.connect() as connection:
            told.append(tuple(connection.execute(sa.select(WORKERS.c.ready, WORKERS.c.fault)).one()))
        if watched.launched:
            stopping.set()
        elif len(told) > LOOKS_APART:
            watched.faults = []
        return stopping.is_set()

    monkeypatch.setattr(stopping, "wait", wait)
    watched.worker.run()
    assert told == [(False, "psi.onnx was changed")] * 2 * LOOKS_APART + [(True, None)]
    assert watched.launched == 1


def test_a_worker_ends_when_a_job_says_that_a_file_is_damaged_and_one_is(watched: Watched) -> None:
    """Jobs may be under way; after the next start it waits for the file. Where all are whole it goes on."""
    watched.faults = ["psi.onnx was changed"]
    watched.worker.doubt()
    watched.worker.runner.doubt.set()
    with pytest.raises(Quit, match=str(TEMPORARY_FAILURE)):
        watched.worker.doubt()
    watched.faults = []
    watched.worker.runner.doubt.set()
    watched.worker.doubt()
    assert not watched.worker.runner.doubt.is_set()


def test_the_end_of_a_job_raises_the_doubt(bench: Bench) -> None:
    for code, doubt in (("no-face", False), ("model-corrupt", True)):
        job = bench.add()
        bench.runner.publish(job, {"kind": "problem", "problem": problem(code, 500, "")})
        assert bench.runner.doubt.is_set() is doubt
