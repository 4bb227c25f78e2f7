"""What a long queue on Postgres costs: admission, listings, housekeeping, and a worker beside its job.

``python -m benchmarks.long_queue [--jobs 100000] [--tenants 100]``. The jobs are copied in the database from one that
was let in, for a hundred tenants; then more are let in one by one, each thing that a worker or a server does beside
the jobs is done, and a worker process, whose one place is taken by a job that sleeps, is watched for a while.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import sqlalchemy as sa
import typer

from service.jobs.admission import Bounds, NewJob
from service.jobs.artifacts import Artifacts
from service.jobs.database import connect, create_tables, now
from service.jobs.janitor import Janitor
from service.jobs.locks import DatabaseLock
from service.jobs.settings import Settings
from service.jobs.store import Store
from service.jobs.workflow import Runner
from tests.support.postgres import Postgres
from tests.support.server import TOY

HANGS = 103
"""Seed of a job of ``tests.support.toy_job`` that sleeps."""

COPIED = """
insert into avatarme_jobs (id, workflow, tenant, turn, created_at, updated_at, {jobs})
select md5(n::text), md5(n::text) || '.1', 'tenant-' || n % :tenants, 2 + n / :tenants, created_at - n, updated_at - n,
{jobs} from avatarme_jobs, generate_series(1, :count) n;
insert into dbos.workflow_status (workflow_uuid, priority, {workflows})
select md5(n::text) || '.1', 2 + n / :tenants, {workflows} from dbos.workflow_status, generate_series(1, :count) n;
"""


def fill(engine: sa.Engine, count: int, tenants: int) -> None:
    """Copy the one job that there is, with its workflow."""
    own = {"avatarme_jobs": ["id", "workflow", "tenant", "turn", "created_at", "updated_at", "key"]}
    own["workflow_status"] = ["workflow_uuid", "priority"]
    inspector, columns = sa.inspect(engine), {}
    for table, schema in (("avatarme_jobs", None), ("workflow_status", "dbos")):
        names = [column["name"] for column in inspector.get_columns(table, schema)]
        columns[table] = ", ".join(f'"{name}"' for name in names if name not in own[table])
    query = COPIED.format(jobs=columns["avatarme_jobs"], workflows=columns["workflow_status"])
    with engine.begin() as connection:
        for statement in query.split(";")[:-1]:
            connection.execute(sa.text(statement), {"count": count, "tenants": tenants})
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(sa.text("vacuum analyze"))


def job(number: int, tenant: str, seed: int = 1) -> NewJob:
    """One more."""
    name, digest = f"{number:032x}", "0" * 64
    return NewJob(
        id=name, tenant=tenant, options={"seed": seed}, photo=f"{name}/photo-{digest}.bin", photo_sha256=digest,
        photo_bytes=1, keep_photo=False, key=f"key-{number}", digest=digest,
    )  # fmt: skip


def milliseconds(call: Callable[[int], object], times: int) -> tuple[float, float]:
    """Median and longest time of a call, which gets its number."""
    taken = []
    for number in range(times):
        begin = time.perf_counter()
        call(number)
        taken.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(taken)), max(taken)


def measured(store: Store, settings: Settings, tenants: int) -> dict[str, tuple[float, float]]:
    """What each thing takes in milliseconds: median and most."""
    runner = Runner(settings, store, Artifacts(settings.artifacts_url))
    janitor, lock = Janitor(runner), DatabaseLock(store.engine, settings.worker)
    bounds = Bounds(queued=1 << 30, unfinished=1 << 30)
    first = 1 << 64
    what: dict[str, tuple[Callable[[int], object], int]] = {
        "admission": (lambda n: store.add(job(first + n, f"tenant-{n % tenants}"), bounds), 200),
        "question whether there is room": (lambda n: store.room(f"tenant-{n}", bounds), 50),
        "a page of 100 of a tenant": (lambda n: store.page(f"tenant-{n % tenants}", 100, None), 50),
        "... of those in one state": (lambda n: store.page(f"tenant-{n % tenants}", 100, None, "failed"), 50),
        "numbers of jobs by state": (lambda n: store.counts(), 50),
        "the job that waits longest": (lambda n: store.oldest(), 50),
        "what runs": (lambda n: store.queue.running(), 50),
        "reconcile": (lambda n: janitor.reconcile(working=False), 50),
        "look for dead workers": (lambda n: janitor.take_over(janitor.dead(lock)), 50),
        "tidy": (lambda n: janitor.tidy(), 50),
        "expire": (lambda n: janitor.expire(), 50),
    }
    found = {name: milliseconds(call, times) for name, (call, times) in what.items()}
    lock.close()
    return found


def seconds_of_processor(process: int) -> float:
    """Time that a process has computed, without its children."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share_of_a_core(settings: Settings, store: Store, seconds: float) -> float:
    """What a worker computes by itself while its one place is taken."""
    command = [sys.executable, "-m", "service.jobs.worker"]
    told = settings.data / "settings.json"
    told.write_text(settings.to_json() + "\n")
    with told.open("rb") as stdin:
        process = subprocess.Popen(command, stdin=stdin, stderr=subprocess.DEVNULL)
    try:
        while not store.counts().get("running"):
            time.sleep(0.1)
        time.sleep(5)  # the start is no idling
        before, begin = seconds_of_processor(process.pid), time.monotonic()
        time.sleep(seconds)
        return (seconds_of_processor(process.pid) - before) / (time.monotonic() - begin)
    finally:
        process.kill()
        process.wait()


def main(jobs: Annotated[int, typer.Option()] = 100_000, tenants: Annotated[int, typer.Option()] = 100) -> None:
    """Print a table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        postgres = Postgres(folder)
        postgres.start()
        try:
            chosen: dict[str, Any] = {"program": TOY, "database": postgres.url, "reserve_mb": 1, "renders": 1}
            settings = Settings(data=folder / "data", **chosen)
            engine = connect(settings.database_url)
            create_tables(engine, settings)
            store = Store(engine)
            photo = folder / "photo"
            photo.write_bytes(b"x")
            new = job(1, "tenant-0", HANGS)
            Artifacts(settings.artifacts_url).put(photo, new.photo)
            store.add(new)
            begin = now()
            fill(engine, jobs, tenants)
            typer.echo(f"{jobs} jobs copied in {now() - begin:.0f} s")
            begin = now()
            create_tables(engine, settings)
            typer.echo(f"start of a process, which counts them: {1e3 * (now() - begin):.0f} ms\n")
            typer.echo("| with so many waiting | median ms | most ms |\n|---|---|---|")
            for what, (median, most) in measured(store, settings, tenants).items():
                typer.echo(f"| {what} | {median:.1f} | {most:.1f} |")
            share = share_of_a_core(settings, store, 30.0)
            typer.echo(f"\na worker beside its job: {100 * share:.2f} % of a core")
            engine.dispose()
        finally:
            postgres.stop("immediate")


if __name__ == "__main__":
    typer.run(main)
