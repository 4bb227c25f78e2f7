"""Faults of the machine under a single job, without a server."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from tests.service.jobs.conftest import Bench


class Order:
    """What reaches the disk, in its order: files and folders that are flushed, files that are renamed, commits."""

    def __init__(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seen: list[tuple[str, str]] = []
        flush, rename = os.fsync, Path.replace

        def noted_flush(handle: int) -> None:
            flush(handle)
            self.seen.append(("flush", Path(os.readlink(f"/proc/self/fd/{handle}")).name))

        def noted_rename(path: Path, target: Path) -> Path:
            self.seen.append(("rename", target.name))
            return rename(path, target)

        monkeypatch.setattr(os, "fsync", noted_flush)
        monkeypatch.setattr(Path, "replace", noted_rename)
        sa.event.listen(bench.engine, "commit", lambda connection: self.seen.append(("commit", "")))

    def place(self, what: str, name: str = "") -> int:
        return self.seen.index((what, name))


def test_a_photo_is_on_the_disk_before_its_job_is(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a power cut a job without its photo could not be kept; the 202 comes after both."""
    order = Order(bench, monkeypatch)
    job = bench.add()
    (photo,) = (Path(name).name for name in bench.artifacts.names(job))
    upload = next(name for what, name in order.seen if what == "flush")
    places = [
        order.place("flush", upload), order.place("rename", photo), order.place("flush", job),
        order.place("flush", "artifacts"), order.place("commit"),
    ]  # fmt: skip
    assert places == sorted(places), order.seen


def test_an_archive_is_on_the_disk_before_its_owner_hears_of_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    job = bench.add()
    bench.runner.accept(f"{job}.1")
    order = Order(bench, monkeypatch)
    outcome = bench.runner.make(job)
    kept = Path(outcome["archive"]).name
    written = len(order.seen)
    bench.runner.publish(job, outcome)
    assert order.place("flush", "archive.zip") < order.place("rename", kept)
    assert ("flush", job) in order.seen[order.place("rename", kept) : written]
    assert ("commit", "") in order.seen[written:]


def test_a_commit_is_on_the_disk(bench: Bench) -> None:
    """SQLite's usual setting with a write-ahead log loses the last commits in a power cut."""
    with bench.engine.connect() as connection:
        assert connection.execute(sa.text("pragma synchronous")).scalar_one() == 2
        assert connection.execute(sa.text("pragma journal_mode")).scalar_one() == "wal"


def test_a_job_whose_photo_is_gone_fails_with_an_answer(bench: Bench) -> None:
    job = bench.add()
    bench.artifacts.sweep(job, set())
    assert bench.run(job) == "published"
    row = bench.row(job)
    assert row["state"] == "failed"
    assert json.loads(row["error"])["status"] == 500
    assert bench.artifacts.names(job) == []


def test_everything_that_a_job_wrote_may_be_deleted_under_it(bench: Bench) -> None:
    """Somebody tidies up the wrong folder between two steps: the job is made again from the photo, or says no."""
    job = bench.add(seed=3)
    bench.runner.accept(f"{job}.1")
    outcome = bench.runner.make(job)
    row = bench.row(job)
    bench.artifacts.sweep(job, {row["photo"]})
    assert bench.runner.publish(job, outcome) == "lost"
    assert bench.runner.make(job) == outcome
    assert bench.runner.publish(job, outcome) == "published"
    assert [name for name in bench.artifacts.names(job) if "archive-" in name]


@pytest.mark.parametrize("cause", [OSError(28, "full"), OSError(30, "read-only"), OSError(5, "input/output error")])
def test_a_disk_that_fails_for_a_while_costs_a_job_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, cause: OSError
) -> None:
    job = bench.add()
    put, failures = bench.artifacts.put, [cause, cause]

    def failing(source: Path, name: str, **named: Any) -> None:
        if "archive-" in name and failures:
            raise failures.pop()
        put(source, name, **named)

    monkeypatch.setattr(bench.artifacts, "put", failing)
    assert bench.run(job) == "published"
    row = bench.row(job)
    assert row["state"] == "succeeded"
    assert not failures
