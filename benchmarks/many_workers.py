"""A batch on up to 200 workers whose photos only sleep: what the database bears, and how evenly the shards are shared.

``python -m benchmarks.many_workers [--workers 10,50,100,200]``. Each worker is a process with its own DBOS, as on a
machine of its own, and takes one shard at a time; Postgres and the store (a folder) are the real ones. All run on this
machine, so what is printed as efficiency has the processor time of all workers in it, which many machines share out.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import sqlalchemy as sa
import typer

from service.batch.makers import Order
from service.batch.plan import Plan
from service.batch.shards import Rounds, Shards
from service.jobs.database import connect, create_tables
from service.jobs.places import Place
from service.jobs.process import descendants
from service.jobs.queue import Queue
from service.jobs.settings import Settings
from service.jobs.workflow import launch
from tests.support.postgres import Postgres

_TICKS = os.sysconf("SC_CLK_TCK")


class Sleeper:
    """Makes a photo by waiting."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def make(self, order: Order, stop: Callable[[], bool]) -> list[str]:
        """A file of some bytes, after a while."""
        time.sleep(self._seconds)
        order.target.write_bytes(b"slept")
        return []

    def close(self) -> None:
        """Nothing to let go of."""


def worker(name: str, database: str, folder: Path, seconds: float) -> None:
    """One worker; ends by a signal."""
    settings = Settings(data=folder / name, database=database, worker=name)
    rounds = Rounds(connect(settings.database_url, pool=1))
    shards = Shards(rounds, Sleeper(seconds), folder / name, threading.Event(), lambda error: None, recorded=True)
    launch(settings, shards.workflows(1))
    signal.pause()


def processor_seconds(processes: list[int]) -> float:
    """Seconds of processor time that processes have had."""
    total = 0
    for process in processes:
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
            total += int(fields[11]) + int(fields[12])
    return total / _TICKS


def measured(count: int, seconds: float, photos: int, folder: Path) -> str:
    """A row of the table: so many workers, each of which would make so many photos of so many seconds."""
    postgres = Postgres(folder, 6 * count + 100)
    postgres.start()
    server = int((folder / "postgres" / "postmaster.pid").read_text().split()[0])
    settings = Settings(data=folder, database=postgres.url)
    engine = connect(settings.database_url)
    create_tables(engine, settings)
    (folder / "in").mkdir()
    for number in range(count * photos):
        (folder / "in" / f"{number:06d}.jpg").touch()
    out = Place(folder / "out")
    plan = Plan(folder, Place(folder / "in"), out)
    plan.look()
    plan.ask({})
    shards = plan.write_shards("1")
    context = multiprocessing.get_context("fork")
    engine.dispose()
    workers = [
        context.Process(target=worker, args=(f"w{n}", postgres.url, folder, seconds), daemon=True) for n in range(count)
    ]
    try:
        for process in workers:
            process.start()
        time.sleep(5.0 + count / 10)  # until all ask for work
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


def main(
    workers: Annotated[str, typer.Option(help="Numbers of workers, with commas between.")] = "10,50,100,200",
    seconds: Annotated[float, typer.Option(help="Of one photo.")] = 10.0,
    photos: Annotated[int, typer.Option(min=1, help="Of each worker.")] = 4,
) -> None:
    """Print the table."""
    print("| workers | photos | shards | of the ideal rate | transactions/s | cores of Postgres ", end="")
    print("| tally, median ms | most | last shard after the mean, % |\n|---|---|---|---|---|---|---|---|---|")
    for word in workers.split(","):
        with tempfile.TemporaryDirectory(prefix="many-workers-") as folder:
            print(measured(int(word), seconds, photos, Path(folder)), flush=True)


if __name__ == "__main__":
    typer.run(main)
