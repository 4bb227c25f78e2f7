"""The steps of a job with real processes, without DBOS."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from service.jobs import runner as running
from service.jobs.process import Task, descendants
from service.jobs.runner import Report, task_of
from service.jobs.settings import Settings
from tests.service.jobs.conftest import Bench
from tests.support.toy_job import archive


def problem(bench: Bench, job: str) -> Any:
    assert bench.row(job)["state"] == "failed"
    return json.loads(bench.row(job)["error"])


def files(bench: Bench, job: str) -> list[str]:
    return sorted(name.split("/")[1].split("-")[0] for name in bench.artifacts.names(job))


def within(seconds: float, check: Any) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if check():
            return True
        time.sleep(0.02)
    return False


def test_a_job_gives_an_archive_and_leaves_nothing_else(bench: Bench) -> None:
    job = bench.add(seed=5)
    assert bench.run(job) == "published"
    row = bench.row(job)
    assert row["state"] == "succeeded"
    assert bench.artifacts.read(row["archive"]) == archive(row["photo_sha256"], 5)
    assert files(bench, job) == ["archive"], "photo and stages are erased at the end"
    assert list(bench.runner.scratch.iterdir()) == []


@pytest.mark.parametrize(
    ("seed", "code", "status"),
    [
        pytest.param(101, "crashed", 500, id="crashed"),
        pytest.param(104, "no-face", 422, id="no-face"),
        pytest.param(105, "internal", 500, id="internal"),
        pytest.param(107, "out-of-memory", 500, id="out-of-memory"),
        pytest.param(109, "numeric-error", 500, id="numeric-error"),
    ],
)
def test_a_job_that_cannot_be_done_ends_with_a_problem(bench: Bench, seed: int, code: str, status: int) -> None:
    job = bench.add(seed=seed)
    bench.run(job)
    found = problem(bench, job)
    assert (found["code"], found["status"]) == (code, status)
    assert "/etc" not in found["detail"], "words of a 5xx never come from an exception"
    assert files(bench, job) == []


def test_a_job_that_takes_its_worker_along_ends(bench: Bench) -> None:
    """Nobody lives to count the crash: a container that is ended as a whole for its memory would never stop."""
    job = bench.add(seed=5)
    for lost in range(running.LOSSES):
        assert bench.store.attempt(job) == lost
    bench.run(job)
    assert problem(bench, job)["code"] == "crashed"
    assert f"{running.LOSSES} times" in problem(bench, job)["detail"]


def test_a_stage_that_gets_finished_makes_up_for_lost_workers(bench: Bench) -> None:
    """Whoever kills the worker now and then must not fail a job that gets ahead each time."""
    job = bench.add(seed=5)
    for _ in range(3 * running.LOSSES):
        bench.store.attempt(job)
        Report(bench.store, job)({"kept": "one"})
    assert bench.row(job)["losses"] == 0
    bench.store.set(job, losses=running.LOSSES - 1)
    bench.run(job)
    assert bench.row(job)["state"] == "succeeded"
    assert bench.row(job)["losses"] == 0


def test_the_end_of_everything_is_no_crash_of_the_job(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service manager signals all processes one after the other: the job's may go before the worker's."""
    monkeypatch.setattr(running, "AFTERMATH", 60.0)
    job = bench.add(seed=103)
    threading.Thread(target=bench.run, args=(job,), daemon=True).start()  # waits for the end of this process
    assert within(60, lambda: bench.runner.active.get(job) and bench.row(job)["losses"] == 1)
    process = bench.runner.active[job]
    assert process is not None
    os.kill(process._process.pid, signal.SIGTERM)
    assert within(10, lambda: process._process.poll() is not None)
    time.sleep(0.5)
    bench.runner.stop()
    assert within(10, lambda: bench.row(job)["losses"] == 0), "a worker that is told to end is not lost"
    assert bench.row(job)["crashes"] == 0
    assert bench.row(job)["state"] == "running", "it goes on after the next start"


def test_memory_has_an_end(bench: Bench) -> None:
    job = bench.add(seed=102)
    bench.run(job)
    assert problem(bench, job)["code"] == "out-of-memory"
    assert bench.row(job)["starved"] == running.OUT_OF_MEMORY, "it was not tried once more"


def test_a_job_without_enough_memory_is_tried_once_more_with_less(bench: Bench) -> None:
    """It says so among its warnings; and a crash is no lack of memory."""
    job = bench.add(seed=108)
    bench.run(job)
    row = bench.row(job)
    assert row["state"] == "succeeded"
    assert (row["starved"], row["crashes"]) == (1, 0)
    assert json.loads(row["warnings"]) == ["toy", "small-tiles"]
    assert bench.artifacts.read(row["archive"]) == archive(row["photo_sha256"], 108)
    crashed = bench.add(seed=106)
    bench.run(crashed)
    assert json.loads(bench.row(crashed)["warnings"]) == ["toy"]


def test_time_has_an_end(bench: Bench) -> None:
    bench.runner.settings = Settings(data=bench.settings.data, program=bench.settings.program, job_seconds=1.0)
    job = bench.add(seed=103)
    bench.run(job)
    assert problem(bench, job)["code"] == "out-of-time"


def test_cancelling_ends_the_process_within_a_second(bench: Bench) -> None:
    job = bench.add(seed=103)
    work = threading.Thread(target=bench.run, args=(job,))
    work.start()
    assert within(60, lambda: bench.row(job)["state"] == "running" and bench.runner.active.get(job))
    process = bench.runner.active[job]
    assert process is not None
    assert bench.store.cancel(job, 1e10)
    begin = time.monotonic()
    assert within(3, lambda: not process.alive())
    assert time.monotonic() - begin < 1.0
    work.join(5)
    assert bench.row(job)["state"] == "cancelled"
    assert within(20, lambda: files(bench, job) == [])


def test_nothing_that_a_job_started_outlives_it(bench: Bench) -> None:
    """The end of a job is the end of its process and of what that started."""
    bench.runner.warm()
    spare = bench.runner._spare
    assert spare is not None
    mine = {spare._process.pid, *descendants(spare._process.pid)}
    assert mine <= set(descendants(os.getpid()))
    bench.runner.stop()
    assert not spare.alive()
    assert not mine & set(descendants(os.getpid()))


def test_a_job_waits_for_space_and_then_goes_on(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk is no fault of the photo."""
    monkeypatch.setattr(running, "SPACE", 0.02)
    free = [0.0]
    monkeypatch.setattr(bench.runner, "free_mb", lambda: free[0])
    jobs = [bench.add(), bench.add()]
    work = [threading.Thread(target=bench.run, args=(job,)) for job in jobs]
    for thread in work:
        thread.start()
    assert within(60, lambda: all(bench.row(job)["state"] == "running" for job in jobs))
    time.sleep(0.3)
    assert [bench.runner.active[job] for job in jobs] == [None, None]
    assert bench.store.cancel(jobs[1], 1e10)
    work[1].join(10)
    assert not work[1].is_alive(), "a job that waits can be cancelled"
    free[0] = 1e6
    work[0].join(30)
    assert [bench.row(job)["state"] for job in jobs] == ["succeeded", "cancelled"]
    assert files(bench, jobs[1]) == []


def test_two_workers_at_the_same_step_make_one_result(bench: Bench) -> None:
    """A frozen worker that wakes up after its job was taken over."""
    job = bench.add(seed=9)
    outcomes: list[Any] = [None, None]

    def work(number: int) -> None:
        outcomes[number] = bench.runner.make(job)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert outcomes[0] == outcomes[1]
    assert bench.runner.publish(job, outcomes[0]) == bench.runner.publish(job, outcomes[1]) == "published"
    assert files(bench, job) == ["archive"]


def test_a_photo_that_changed_on_the_disk_is_noticed(bench: Bench) -> None:
    """The pipeline's own process compares the hash; the toy job has no such check, so that process is asked."""
    from service.errors import CorruptImage
    from service.jobs import avatar_process
    from service.jobs.process import Reporter, Task

    photo = bench.settings.data / "photo"
    photo.write_bytes(b"other")
    task = Task(job="0" * 32, photo=str(photo), photo_sha256="0" * 64, options={}, artifacts="", output="", scratch="")
    with pytest.raises(CorruptImage, match="changed"):
        avatar_process.run(task, Reporter.__new__(Reporter))


def test_another_release_goes_on_with_a_job_and_computes_its_stages_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has the same version of the workflows: DBOS gives a job of another version to nobody."""
    from service.jobs import avatar_process
    from service.jobs.process import Task
    from service.jobs.queue import VERSION

    task = Task(job="0" * 32, photo="", photo_sha256="0" * 64, options={}, artifacts="", output="", scratch="")
    before = avatar_process.cache_basis(task)
    monkeypatch.setattr(avatar_process, "GENERATOR", "avatarme 99")
    assert avatar_process.cache_basis(task) != before
    assert VERSION == "pipeline-5", "with another one all unfinished jobs would wait for ever"


def test_a_correction_is_made_from_the_stages_of_the_same_owner_s_photo(bench: Bench) -> None:
    from service.jobs import avatar_process

    def task(tenant: str, keep: bool) -> Task:
        same_photo: Any = {**bench.row(bench.add(tenant=tenant, keep_photo=keep)), "photo_sha256": "0" * 64}
        return task_of(same_photo, None, bench.settings, Path(), Path())

    first = task("a", True)
    assert first.stages == task("a", True).stages != task("b", True).stages
    assert task("a", False).stages == ""
    wishes = ({"quality": "draft"}, {"quality": "draft", "hair": "bob", "wrinkles": "older"}, {"quality": "high"})
    plain, corrected, better = (avatar_process.cache_basis(replace(first, options=wish)) for wish in wishes)
    assert plain == corrected != better
