"""What operators see of a job: one line for each turn of its life, counts, times of stages."""

from __future__ import annotations

import logging

import pytest

from service.jobs import telemetry
from service.jobs.store import depart, forget
from tests.service.jobs.conftest import Bench

RESULT = {"archive": "a", "sha256": "0" * 64, "bytes": 1, "warnings": [], "peak_rss_mb": 5.0}


def lines(caplog: pytest.LogCaptureFixture, job: str) -> list[logging.LogRecord]:
    return [record for record in caplog.records if getattr(record, "job", None) == job and hasattr(record, "event")]


def test_each_turn_is_one_line_that_names_job_and_tenant(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    job = bench.add(1, tenant="ada")
    assert bench.run(job) == "published"
    told = lines(caplog, job)
    assert [record.event for record in told] == ["accepted", "started", "stage", "stage", "stage", "ended"]  # type: ignore[attr-defined]
    assert {record.tenant for record in told} == {"ada"}  # type: ignore[attr-defined]
    assert [record.stage for record in told if record.event == "stage"] == ["one", "two", "three"]  # type: ignore[attr-defined]
    end = vars(told[-1])
    assert (end["state"], end["code"]) == ("succeeded", None)
    assert end["took_s"] > 0 and end["waited_s"] >= 0 and end["stages_s"]


def test_ends_are_counted_by_code_and_outlive_the_jobs(bench: Bench) -> None:
    for seed in (1, 2, 104):
        bench.run(bench.add(seed))
    bench.store.cancel(bench.add(), 1e10)
    for row in bench.store.where():
        depart(bench.engine, row["id"], "erased")
        forget(bench.engine, row["id"])
    ended = telemetry.counts(bench.engine, telemetry.ENDED)
    assert ended == {"avatar/succeeded/": 2, "avatar/failed/no-face": 1, "avatar/cancelled/": 1}


def test_times_of_stages_are_a_histogram(bench: Bench) -> None:
    for seconds in (0.05, 0.2, 2.0, 5000.0):
        job = bench.add()
        bench.store.begin(f"{job}.1")
        bench.store.succeed(job, {**RESULT, "timings": {"fit": seconds}}, 1e10)
    ((stage, buckets, total),) = telemetry.histograms(bench.engine)
    assert stage == "fit"
    assert dict(buckets)["0.1"] == 1 and dict(buckets)["3"] == 3 and dict(buckets)["+Inf"] == 4
    assert [count for _, count in buckets] == sorted(count for _, count in buckets), "cumulative"
    assert total == pytest.approx(5002.25)
