"""Letting jobs in: bounds hold however many ask at once, and nobody's jobs keep another one waiting."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from service.jobs.admission import LOW, Bounds, NoRoom
from service.jobs.database import JOBS, now
from service.jobs.store import depart
from tests.service.jobs.conftest import Bench, unfinished
from tests.support.postgres import Postgres, find_programs
from tests.support.server import in_threads

_SLOW = [
    pytest.mark.slow,
    pytest.mark.skipif(find_programs() is None, reason="Postgres is not installed (apt-get install postgresql)"),
]


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=_SLOW)])
def any_bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    postgres = Postgres(tmp_path) if request.param == "postgres" else None
    if postgres is not None:
        postgres.start()
    made = Bench(tmp_path / "data", database="" if postgres is None else postgres.url)
    yield made
    made.close()
    if postgres is not None:
        postgres.stop("immediate")


@pytest.mark.parametrize(
    "bounds",
    [
        Bounds(queued=100, unfinished=2),
        Bounds(queued=2, unfinished=100),
        Bounds(queued=100, unfinished=100, per_day=2),
    ],
)
def test_twenty_at_once_get_no_more_than_the_bound(any_bench: Bench, bounds: Bounds) -> None:
    def one(_: int) -> str:
        try:
            any_bench.add(bounds=bounds)
        except NoRoom as full:
            return full.kind
        return "let in"

    told = Counter(in_threads(20, one))
    assert told["let in"] == 2, told
    with any_bench.engine.connect() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(JOBS)).scalar_one() == 2
    assert len(unfinished(any_bench.queue)) == 2, "what was refused is in no queue"


def order(bench: Bench) -> list[str]:
    """Tenants in the order in which their waiting jobs are served, by the queue itself."""
    waiting = sorted(unfinished(bench.queue), key=lambda status: (status.priority, status.created_at))
    rows = [bench.store.get(status.workflow_id.partition(".")[0]) for status in waiting]
    return [str(row["tenant"]) for row in rows if row is not None]


def test_one_tenants_many_jobs_do_not_keep_another_waiting(any_bench: Bench) -> None:
    jobs = [any_bench.add(tenant="a") for _ in range(25)]
    any_bench.store.begin(f"{jobs[0]}.1")
    for _ in range(3):
        any_bench.add(tenant="b")
    served = list(order(any_bench))[1:]  # the first runs
    assert served[:6] == ["b", "a", "b", "a", "b", "a"] or served[:6] == ["b", "b", "a", "b", "a", "a"], served
    assert served.index("b") == 0


def test_whoever_was_away_gets_no_credit_for_it(any_bench: Bench) -> None:
    """The turns go on while a tenant has no jobs; afterwards it shares, and is not served alone."""
    for _ in range(10):
        job = any_bench.add(tenant="a")
        any_bench.store.begin(f"{job}.1")
        any_bench.store.cancel(job, now() + 100)
    for _ in range(4):
        any_bench.add(tenant="a")
    for _ in range(4):
        any_bench.add(tenant="b")
    waiting = list(any_bench.store.where(JOBS.c.state == "queued"))
    turns = {who: sorted(row["turn"] for row in waiting if row["tenant"] == who) for who in "ab"}
    assert turns["a"] == turns["b"]


def test_low_priority_gives_way_to_everybody(any_bench: Bench) -> None:
    any_bench.add(tenant="a", priority="low")
    any_bench.add(tenant="b", priority="low")
    any_bench.add(tenant="b")
    assert order(any_bench)[0] == "b"
    assert sorted(row["turn"] >= LOW for row in any_bench.store.where()) == [False, True, True]


def test_high_priority_overtakes_the_tenants_own_jobs_only(any_bench: Bench) -> None:
    """Nothing changes while it waits; the next turn of its tenant that comes is its own, and its turn another's."""
    own = [any_bench.add(tenant="a") for _ in range(3)]
    other = [any_bench.add(tenant="b") for _ in range(3)]
    urgent = any_bench.add(tenant="a", priority="high")
    later = any_bench.add(tenant="a", priority="high")
    turns = {row["id"]: row["turn"] for row in any_bench.store.where()}
    begun = [any_bench.store.begin(f"{job}.1") for job in (other[0], own[0], own[1], own[2], urgent, later, other[1])]
    assert begun == [other[0], urgent, later, own[2], own[0], own[1], other[1]]
    rows = {row["id"]: row for row in any_bench.store.where()}
    assert (rows[urgent]["turn"], rows[later]["turn"]) == (turns[own[0]], turns[own[1]])
    assert sorted(row["turn"] for row in rows.values()) == sorted(turns.values())
    assert all(rows[job]["turn"] == turns[job] for job in other), "nobody else waits longer"
    assert any_bench.store.begin(f"{own[0]}.1") == urgent, "a worker that died goes on with the same job"


def test_a_turn_is_used_once_however_many_workers_take_them(any_bench: Bench) -> None:
    jobs = [any_bench.add(priority=priority) for priority in ("normal",) * 8 + ("high",) * 4]
    begun = in_threads(12, lambda number: any_bench.store.begin(f"{jobs[number]}.1"))
    assert sorted(job for job in begun if job is not None) == sorted(jobs)
    assert any_bench.store.counts() == {"running": 12}


def test_counts_are_of_the_jobs_that_are_kept(any_bench: Bench) -> None:
    first, second, third = (any_bench.add(tenant=who) for who in "aab")
    any_bench.store.begin(f"{first}.1")
    any_bench.store.cancel(second, now() + 100)
    any_bench.store.begin(f"{third}.1")
    any_bench.store.fail(third, {"code": "no-face"}, now() + 100)
    assert any_bench.store.counts() == {"running": 1, "cancelled": 1, "failed": 1}
    any_bench.store.room("a", Bounds(queued=1, unfinished=2))
    with pytest.raises(NoRoom):
        any_bench.store.room("a", Bounds(queued=1, unfinished=1))
    depart(any_bench.engine, third, "erased")
    assert any_bench.store.counts() == {"running": 1, "cancelled": 1}
