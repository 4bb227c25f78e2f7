from __future__ import annotations

import json
import threading

import pytest

from service.jobs.admission import KeyInUse
from service.jobs.store import checkpoint, depart
from tests.service.jobs.conftest import Bench, unfinished

RESULT = {"archive": "x", "sha256": "0" * 64, "bytes": 3, "warnings": [], "timings": {}, "peak_rss_mb": 1.0}


def test_every_change_is_an_event_with_the_state_as_it_was(bench: Bench) -> None:
    job = bench.add()
    bench.store.begin(f"{job}.1")
    bench.store.progress(job, "fit", 0.5)
    bench.store.succeed(job, RESULT, 1e10)
    events = bench.store.events(job, 0)
    assert [event["n"] for event in events] == [1, 2, 3, 4]
    bodies = [json.loads(event["body"]) for event in events]
    assert [body["state"] for body in bodies] == ["queued", "running", "running", "succeeded"]
    assert [event["name"] for event in events] == ["state", "state", "progress", "state"]
    assert bodies[2]["stage"] == "fit"
    assert [event["n"] for event in bench.store.events(job, 2)] == [3, 4]


def test_progress_never_falls(bench: Bench) -> None:
    """A run that was cut off begins again with its first stage; its owner has not lost what was done."""
    job = bench.add()
    bench.store.begin(f"{job}.1")
    shares = []
    for stage, share in (("one", 0.1), ("two", 0.6), ("one", 0.1), ("two", 0.6), ("three", 0.7), ("three", 7.0)):
        assert bench.store.progress(job, stage, share)
        row = bench.row(job)
        assert row["stage"] == stage
        shares.append(row["progress"])
    assert shares == [0.1, 0.6, 0.6, 0.6, 0.7, 1.0]


def test_what_is_gone_leaves_its_times(bench: Bench) -> None:
    """A client that erases what it has fetched must not take the measured times along, and nothing else may stay."""
    job = bench.add()
    bench.store.set(job, options=json.dumps({"quality": "draft", "size": None, "maps": ["texture"], "face": 3}))
    depart(bench.engine, job, "erased")
    assert bench.store.measured() == [], "it has not ended"
    bench.store.succeed(job, RESULT, 1e10)
    for _ in range(2):
        depart(bench.engine, job, "erased")
    (row,) = bench.store.measured()
    assert json.loads(row["options"]) == {"quality": "draft", "size": None, "maps": ["texture"]}
    assert bench.store.events(job, 0) == []


def test_the_first_end_stays(bench: Bench) -> None:
    """A worker that was thought dead must not turn a cancelled job into a succeeded one."""
    job = bench.add()
    assert bench.store.cancel(job, 1e10)
    assert not bench.store.succeed(job, RESULT, 1e10)
    assert not bench.store.fail(job, {"code": "x"}, 1e10)
    assert not bench.store.begin(f"{job}.1")
    assert not bench.store.progress(job, "fit", 0.5)
    row = bench.row(job)
    assert row["state"] == "cancelled"
    assert row["archive"] is None


def test_a_key_makes_one_job_however_many_ask_at_once(bench: Bench) -> None:
    made, refused = [], []

    def ask() -> None:
        try:
            made.append(bench.add(key="k"))
        except KeyInUse as used:
            refused.append(used.row["id"])

    jobs = [threading.Thread(target=ask) for _ in range(16)]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
    assert len(made) == 1
    assert refused == made * 15
    assert bench.store.counts() == {"queued": 1}
    assert len(unfinished(bench.queue)) == 1


def test_a_job_that_cannot_be_queued_is_not_stored(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Accepting and queueing are one transaction: no job without a place in the queue."""
    monkeypatch.setattr(bench.queue, "put", lambda *a: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        bench.add()
    assert bench.store.counts() == {}


def test_a_cancelled_job_leaves_no_word_of_its_request(bench: Bench) -> None:
    """Not in its earlier events either, which have the job as it was then."""
    job = bench.add(metadata={"client": "words-of-the-owner"}, key="key-of-the-owner")
    bench.store.begin(f"{job}.1")
    bench.store.progress(job, "fit", 0.5)
    assert len(bench.store.events(job, 0)) == 3
    assert bench.store.cancel(job, 1e10)
    (last,) = bench.store.events(job, 0)
    assert json.loads(last["body"])["state"] == "cancelled"
    bench.engine.dispose()
    assert checkpoint(bench.engine)
    stored = b"".join(path.read_bytes() for path in bench.settings.data.glob("jobs.sqlite*"))
    assert b"-of-the-owner" not in stored
