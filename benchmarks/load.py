"""What the database bears: a batch on up to 200 workers whose photos only sleep, and a queue of 100,000 waiting jobs;
and how long a draft takes over HTTP.

``python -m benchmarks.load [--workers 10,50,100,200]``, ``python -m benchmarks.load --waiting 100000`` and ``python -m
benchmarks.load --draft PHOTO``, which starts ``avatarme serve`` as it is installed and posts one photo after the other,
each some seconds after the last, when the worker has a process ready. The waiting jobs are copied in the database from
one that was let in, for a hundred tenants. A worker is a process with its own DBOS, as on a machine of its own, that
takes one shard at a time; Postgres and the store (a folder) are the real ones. All run on this machine, so what is
printed as efficiency has the processor time of all workers in it, which many machines share out: a worker's looks into
the queues are one to two percent of a core, of which 200 do not fit on two cores. ``--hands 10`` has each process take
ten shards at a time, as ten workers that look into the queues together.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import httpx
import numpy as np
import sqlalchemy as sa
import typer

from service.batch.makers import Maker, Order
from service.batch.plan import Plan
from service.batch.shards import Rounds, Shards
from service.batch.worker import LOOKS
from service.jobs.admission import Bounds, NewJob
from service.jobs.artifacts import Artifacts
from service.jobs.database import connect, create_tables
from service.jobs.process import descendants
from service.jobs.queue import Queue
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from service.jobs.store import Store
from service.jobs.worker import Janitor
from service.jobs.workflow import launch
from service.places import Place
from tests.support.postgres import Postgres
from tests.support.server import TOY, Server, post

TENANTS = 100
HANGS = 103
"""Seed of a job of ``tests.support.toy_job`` that sleeps."""

COPIED = """
insert into avatarme_jobs (id, workflow, tenant, turn, created_at, updated_at, {jobs})
select md5(n::text), md5(n::text) || '.1', 'tenant-' || n % :tenants, 2 + n / :tenants, created_at - n, updated_at - n,
{jobs} from avatarme_jobs, generate_series(1, :count) n where avatarme_jobs.workflow = :first;
insert into dbos.workflow_status (workflow_uuid, priority, {workflows})
select md5(n::text) || '.1', 2 + n / :tenants, {workflows} from dbos.workflow_status, generate_series(1, :count) n
where workflow_uuid = :first;
"""

_TICKS = os.sysconf("SC_CLK_TCK")


class Sleeper(Maker):
    """Makes a photo by waiting."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def make(self, order: Order, stop: Callable[[], bool]) -> list[str]:
        """A file of some bytes, after a while."""
        time.sleep(self._seconds)
        order.target.write_bytes(b"slept")
        return []


def worker(name: str, database: str, folder: Path, seconds: float, hands: int) -> None:
    """A process of so many workers; ends by a signal."""
    settings = Settings(data=folder / name, database=database, worker=name)
    rounds = Rounds(connect(settings.database_url, pool=min(hands, 8)))
    shards = Shards(rounds, Sleeper(seconds), folder / name, threading.Event(), lambda error: None)
    launch(settings, shards.workflows(hands, settings.look_seconds / LOOKS))
    signal.pause()


def processor_seconds(processes: list[int]) -> float:
    """Seconds of processor time that processes have had."""
    total = 0
    for process in processes:
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
            total += int(fields[11]) + int(fields[12])
    return total / _TICKS


def measured(count: int, seconds: float, photos: int, hands: int, folder: Path) -> str:
    """A row of the table: so many workers, each of which would make so many photos of so many seconds.

    Args:
        count: of workers.
        seconds: of one photo.
        photos: of each worker.
        hands: workers that are one process.
        folder: for everything.
    """
    postgres = Postgres(folder, 6 * count + 100)
    postgres.start()
    server = postgres.process()
    settings = Settings(data=folder, database=postgres.url)
    engine = connect(settings.database_url)
    create_tables(engine, settings)
    (folder / "in").mkdir()
    for number in range(count * photos):
        (folder / "in" / f"{number:06d}.jpg").touch()
    out = Place(folder / "out")
    plan = Plan(Place(folder / "in"), out)
    plan.look()
    plan.ask({})
    shards = plan.write_shards("1")
    context = multiprocessing.get_context("fork")
    engine.dispose()
    workers = [
        context.Process(
            target=worker, args=(f"w{first}", postgres.url, folder, seconds, min(hands, count - first)), daemon=True
        )
        for first in range(0, count, hands)
    ]
    try:
        for process in workers:
            process.start()
        time.sleep(5.0 + len(workers) / 2)  # until all ask for work
        rounds, queue = Rounds(engine), Queue(engine)
        before, spent, begin = transactions(engine), processor_seconds(descendants(server)), time.monotonic()
        rounds.put(queue, "1", out.address, shards)
        listings, ends, ended = list[float](), list[float](), 0
        while ended < len(shards):
            time.sleep(0.5)
            asked = time.perf_counter()
            unfinished = rounds.tally("1")[2]
            listings.append(1e3 * (time.perf_counter() - asked))
            ends += [time.monotonic() - begin] * (len(shards) - unfinished - ended)
            ended = len(shards) - unfinished
        took = time.monotonic() - begin
        load = (transactions(engine) - before) / took
        cores = (processor_seconds(descendants(server)) - spent) / took
    finally:
        for process in workers:
            process.kill()
            process.join()
        engine.dispose()
        postgres.stop("immediate")
    ideal = count * photos * seconds / count
    skew = max(ends) / float(np.mean(ends[-count:])) - 1.0
    return (
        f"| {count} | {count * photos} | {len(shards)} | {ideal / took:.2f} | {load:.0f} | {cores:.2f} "
        f"| {np.median(listings):.1f} | {max(listings):.1f} | {100 * skew:.0f} |"
    )


def transactions(engine: sa.Engine) -> int:
    """Transactions that the database has ended."""
    with engine.connect() as connection:
        query = "select xact_commit + xact_rollback from pg_stat_database where datname = current_database()"
        return int(connection.execute(sa.text(query)).scalar_one())


def fill(engine: sa.Engine, count: int, workflow: str) -> None:
    """Copy the job of a workflow, with that."""
    own = {"id", "workflow", "tenant", "turn", "created_at", "updated_at", "key", "workflow_uuid", "priority"}
    inspector, columns = sa.inspect(engine), {}
    for name, table, schema in (("jobs", "avatarme_jobs", None), ("workflows", "workflow_status", "dbos")):
        names = (column["name"] for column in inspector.get_columns(table, schema))
        kept = own - {"priority"} if schema is None else own
        columns[name] = ", ".join(f'"{column}"' for column in names if column not in kept)
    with engine.begin() as connection:
        for statement in COPIED.format(**columns).split(";")[:-1]:
            connection.execute(sa.text(statement), {"count": count, "tenants": TENANTS, "first": workflow})
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(sa.text("vacuum analyze"))


def new_job(number: int, seed: int = 1) -> NewJob:
    """One more."""
    name, digest = f"{number:032x}", "0" * 64
    return NewJob(
        id=name, tenant=f"tenant-{number % TENANTS}", options={"seed": seed}, photo=f"{name}/photo-{digest}.bin",
        photo_sha256=digest, photo_bytes=1, keep_photo=False, key=f"key-{number}", digest=digest,
    )  # fmt: skip


def calls(store: Store, settings: Settings, first: int = 1 << 64) -> dict[str, Callable[[int], object]]:
    """What is asked of the database beside the jobs; each call gets its number, a new job one from ``first`` on."""
    janitor = Janitor(Runner(settings, store, Artifacts(settings.artifacts_url)))
    bounds = Bounds(queued=1 << 30, unfinished=1 << 30)
    return {
        "admission": lambda n: store.add(new_job(first + n), bounds),
        "is there room": lambda n: store.room(f"tenant-{n}", bounds),
        "a page of 100": lambda n: store.page(f"tenant-{n % TENANTS}", 100, None),
        "numbers by state": lambda n: store.counts(),
        "the oldest": lambda n: store.oldest(),
        "what runs": lambda n: store.queue.client.list_workflows(status="PENDING", load_input=False, load_output=False),
        "reconcile, every 10 s": lambda n: janitor.reconcile(working=False),
        "tidy, every 5 s": lambda n: janitor.tidy(),
        "expire, every 30 s": lambda n: janitor.expire(),
    }


def milliseconds(call: Callable[[int], object], server: int, times: int = 50) -> str:
    """Median and longest time of a call, and the processor time of both sides on average, as cells of a table.

    Args:
        call: gets its number.
        server: process id of Postgres.
        times: how often.
    """
    taken, before = list[float](), time.process_time() + processor_seconds(descendants(server))
    for number in range(times):
        begin = time.perf_counter()
        call(number)
        taken.append(1e3 * (time.perf_counter() - begin))
    spent = time.process_time() + processor_seconds(descendants(server)) - before
    return f"{np.median(taken):.1f} | {max(taken):.1f} | {1e3 * spent / times:.1f}"


def waiting_jobs(count: int, folder: Path, seconds: float = 30.0) -> None:
    """Print what each call takes beside so many waiting jobs, and a worker whose one place is taken."""
    postgres = Postgres(folder)
    postgres.start()
    settings = Settings(data=folder / "data", program=TOY, database=postgres.url, reserve_mb=1)
    engine = connect(settings.database_url)
    try:
        create_tables(engine, settings)
        store, first = Store(engine), new_job(1, HANGS)
        (folder / "photo").write_bytes(b"x")
        Artifacts(settings.artifacts_url).put(folder / "photo", first.photo)
        store.add(first)
        server = postgres.process()
        alone = {name: milliseconds(call, server) for name, call in calls(store, settings, 1 << 48).items()}
        fill(engine, count, f"{first.id}.1")
        create_tables(engine, settings)
        print(f"| median, most, processor time, ms | with {count} waiting | | | with 50 | | |\n{'|---' * 7}|")
        for name, call in calls(store, settings).items():
            print(f"| {name} | {milliseconds(call, server)} | {alone[name]} |", flush=True)
        told = folder / "settings"
        told.write_text(settings.to_json() + "\n")
        with told.open("rb") as stdin:
            command = [sys.executable, "-m", "service.jobs.worker"]
            process = subprocess.Popen(command, stdin=stdin, stderr=subprocess.DEVNULL)
        try:
            while not store.counts().get("running"):
                time.sleep(0.1)
            time.sleep(65.0)  # the start is no idling, and DBOS looks for schedules every second in the first minute
            spent, begin = processor_seconds([process.pid]), time.monotonic()
            time.sleep(seconds)
            share = (processor_seconds([process.pid]) - spent) / (time.monotonic() - begin)
            print(f"\na worker beside its job: {100 * share:.2f} % of a core")
        finally:
            process.kill()
            process.wait()
    finally:
        engine.dispose()
        postgres.stop("immediate")


def drafts(photo: Path, folder: Path, count: int = 4, pause: float = 6.0) -> None:
    """Print seconds from posting each of some drafts to its archive being ready, and to each of its stages."""
    usual = {"program": Settings.program, "look_seconds": Settings.look_seconds, "niceness": Settings.niceness}
    server = Server(folder / "data", usual)
    server.start()
    print(f"| draft | ready after s | of these in its process | fetched after | stages begun after |\n{'|---' * 5}|")
    try:
        with httpx.Client(base_url=server.url, timeout=60) as client:
            for number in range(count):
                time.sleep(pause)
                begin, begun = time.monotonic(), dict[str, float]()
                job = post(client, photo.read_bytes(), number, quality="draft").json()["id"]
                state: dict[str, Any] = {}
                # Asking again and again would take a tenth of the processor from what is measured.
                with client.stream("GET", f"/v1/avatars/{job}/events") as events:
                    for line in events.iter_lines():
                        if line.startswith("data:"):
                            state = json.loads(line.removeprefix("data:"))
                            begun.setdefault(state["stage"] or state["state"], time.monotonic() - begin)
                ready, first = begun.pop(state["state"]), begun.get("decode", 0.0)
                size = len(client.get(state["links"]["archive"]).raise_for_status().content)
                told = ", ".join(f"{name} {seconds:.2f}" for name, seconds in begun.items())
                print(f"| {number + 1} | {ready:.2f} | {ready - first:.2f} ", end="")
                print(f"| {time.monotonic() - begin:.2f} ({size / 1e6:.1f} MB) | {told} |", flush=True)
    finally:
        server.stop()


def main(
    workers: Annotated[str, typer.Option(help="Numbers of workers, with commas between.")] = "10,50,100,200",
    seconds: Annotated[float, typer.Option(help="Of one photo.")] = 10.0,
    photos: Annotated[int, typer.Option(min=1, help="Of each worker.")] = 8,
    hands: Annotated[int, typer.Option(min=1, help="Workers that are one process.")] = 1,
    waiting: Annotated[int, typer.Option(min=0, help="Measure beside so many waiting jobs instead.")] = 0,
    draft: Annotated[Path | None, typer.Option(help="Measure drafts of this photo over HTTP instead.")] = None,
) -> None:
    """Print a table."""
    if draft is not None:
        with tempfile.TemporaryDirectory(prefix="drafts-") as folder:
            drafts(draft, Path(folder))
        return
    if waiting:
        with tempfile.TemporaryDirectory(prefix="waiting-") as folder:
            waiting_jobs(waiting, Path(folder))
        return
    print("| workers | photos | shards | of the ideal rate | transactions/s | cores of Postgres ", end="")
    print("| tally, median ms | most | last shard after the mean, % |\n|---|---|---|---|---|---|---|---|---|")
    for word in workers.split(","):
        with tempfile.TemporaryDirectory(prefix="many-workers-") as folder:
            print(measured(int(word), seconds, photos, hands, Path(folder)), flush=True)


if __name__ == "__main__":
    typer.run(main)
