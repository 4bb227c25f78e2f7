from __future__ import annotations

import time

import pytest
import sqlalchemy as sa

from service.jobs import worker as module
from service.jobs.database import JOBS, WORKERS, DatabaseLock, create_tables, now
from service.jobs.worker import STRAY, Janitor, LostJob
from tests.service.jobs.conftest import Bench, unfinished


@pytest.fixture
def janitor(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Janitor:
    monkeypatch.setattr(module, "SETTLED", -1.0)
    return Janitor(bench.runner)


def pretend(bench: Bench, workflow: str, **values: object) -> None:
    """Change what DBOS has recorded of a workflow."""
    assignments = ", ".join(f"{name} = :{name}" for name in values)
    with bench.engine.begin() as connection:
        query = sa.text(f"update workflow_status set {assignments} where workflow_uuid = :id")  # noqa: S608
        assert connection.execute(query, {**values, "id": workflow}).rowcount == 1


def dead(janitor: Janitor, bench: Bench, lock: DatabaseLock) -> set[str]:
    """As a worker finds them with each sign of life."""
    with bench.engine.connect() as connection:
        others = janitor.others(connection)
    return janitor.dead(others, lock)


def test_results_expire_and_their_address_says_so_for_a_while(bench: Bench, janitor: Janitor) -> None:
    job = bench.add()
    bench.run(job)
    janitor.expire()
    assert bench.artifacts.names(job), "not yet"
    bench.store.set(job, expires_at=now() - 1)
    janitor.expire()
    janitor.tidy()
    row = bench.row(job)
    assert row["gone"] == "expired"
    assert bench.artifacts.names(job) == []
    assert bench.store.events(job, 0) == []
    bench.store.set(job, updated_at=now() - bench.settings.tombstone_hours * 3600 - 1)
    janitor.expire()
    assert bench.store.get(job) is None
    assert bench.queue.states([f"{job}.1"]) == {}


def test_what_a_killed_worker_left_is_erased(bench: Bench, janitor: Janitor) -> None:
    job = bench.add()
    bench.store.cancel(job, now() + 1000)
    assert bench.artifacts.names(job), "the photo is still there"
    janitor.tidy()
    assert bench.artifacts.names(job) == []


def test_a_job_that_the_queue_forgot_is_put_back(bench: Bench, janitor: Janitor) -> None:
    job = bench.add()
    bench.queue.delete([f"{job}.1"])
    assert unfinished(bench.queue) == []
    janitor.reconcile()
    assert [status.workflow_id for status in unfinished(bench.queue)] == [f"{job}.1"]


@pytest.mark.parametrize("status", ["ERROR", "MAX_RECOVERY_ATTEMPTS_EXCEEDED", "SUCCESS"])
def test_a_job_whose_workflow_ended_without_an_answer_fails(bench: Bench, janitor: Janitor, status: str) -> None:
    job = bench.add()
    pretend(bench, f"{job}.1", status=status)
    janitor.reconcile()
    row = bench.row(job)
    assert row["state"] == "failed"
    assert '"crashed"' in row["error"]


def test_a_job_that_should_run_here_and_does_not_restarts_the_worker(
    bench: Bench, janitor: Janitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its thread died of a full disk; only a new process takes it up again."""
    job = bench.add()
    pretend(bench, f"{job}.1", status="PENDING", executor_id="solo")
    janitor.reconcile()
    monkeypatch.setattr(module, "LOST", 0.0)
    with pytest.raises(LostJob):
        janitor.reconcile()
    bench.runner.active[job] = None
    janitor.reconcile()
    bench.runner.active.clear()


def test_a_worker_that_takes_no_jobs_is_not_blamed_for_its_own_and_others_get_them(
    bench: Bench, janitor: Janitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One whose weights are damaged waits for whole ones; its jobs need not."""
    monkeypatch.setattr(module, "LOST", -1.0)
    job = bench.add()
    pretend(bench, f"{job}.1", status="PENDING", executor_id="solo")
    janitor.reconcile(working=False)
    with pytest.raises(LostJob):
        janitor.reconcile()
    pretend(bench, f"{job}.1", executor_id="w2")
    beat = {"name": "w2", "version": "1", "ready": True, "seen_at": time.time()}
    with bench.engine.begin() as connection:
        connection.execute(sa.insert(WORKERS).values(**beat))
    lock = DatabaseLock(bench.engine, "solo")
    assert [dead(janitor, bench, lock) for _ in range(2)] == [set(), set()]
    with bench.engine.begin() as connection:
        connection.execute(sa.update(WORKERS).values(ready=False, fault="psi.onnx was changed"))
    assert [dead(janitor, bench, lock) for _ in range(3)] == [set(), {"w2"}, {"w2"}]


def test_a_clock_that_is_set_forward_takes_no_jobs_from_the_living(bench: Bench, janitor: Janitor) -> None:
    """By the clock of Postgres, all workers are silent until their next sign of life: their jobs would run twice."""
    lock, long_ago = DatabaseLock(bench.engine, "solo"), time.time() - 2 * module.SILENT
    beats = [{"name": name, "version": "1", "ready": True, "seen_at": long_ago} for name in ("w2", "w3")]
    with bench.engine.begin() as connection:
        connection.execute(sa.insert(WORKERS), beats)
    assert dead(janitor, bench, lock) == set(), "seen once only"
    with bench.engine.begin() as connection:
        connection.execute(sa.update(WORKERS).where(WORKERS.c.name == "w3").values(seen_at=time.time()))
    assert dead(janitor, bench, lock) == {"w2"}


def test_a_database_of_an_older_version_gets_the_columns_that_it_lacks(bench: Bench) -> None:
    job = bench.add(seed=5)
    with bench.engine.begin() as connection:
        connection.execute(sa.text("alter table avatarme_jobs drop column losses"))
    for _ in range(2):
        create_tables(bench.engine, bench.settings)
    bench.run(job)
    row = bench.row(job)
    assert (row["state"], row["losses"]) == ("succeeded", 0)
    with bench.engine.begin() as connection:  # as a version that does not know the column
        names = ", ".join(column.name for column in JOBS.columns if column.name not in ("losses", "id", "workflow"))
        connection.execute(
            sa.text(f"insert into avatarme_jobs (id, workflow, {names}) select 'x', 'x.1', {names} from avatarme_jobs")  # noqa: S608
        )


def test_nothing_in_the_database_is_a_pickle(bench: Bench) -> None:
    """Whoever can write the database must not get code to run."""
    job = bench.add()
    with bench.engine.connect() as connection:
        dump = "\n".join(connection.connection.driver_connection.iterdump())  # type: ignore[union-attr]
    assert f'{{"args": ["{job}"], "kwargs": {{}}}}' in dump
    assert "py_pickle" not in dump


def test_files_that_became_no_job_go_after_an_hour(
    bench: Bench, janitor: Janitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour of being seen: by the clock on the wall, which may be set by a day, a new one may look old."""
    folder = bench.artifacts.folder
    assert folder is not None
    unknown, job = folder / ("c" * 32), bench.add()
    unknown.mkdir()
    (unknown / f"photo-{'0' * 64}.bin").write_bytes(b"x")
    janitor.sweep_strays()
    assert unknown.exists()
    later = time.monotonic() + STRAY
    monkeypatch.setattr(time, "monotonic", lambda: later)
    janitor.sweep_strays()
    assert not unknown.exists()
    assert bench.artifacts.names(job)
