"""Data for training, drawn in shards by the engine of batches: on this machine, or by workers on many.

An *order* is a small JSON file that says what one file of data holds; it has the name of that file, and lies among the
data until the file is there. So an interrupted run goes on where it stopped, a file is written whole or not at all on a
store too, and a worker that dies is replaced. On each of several machines that share a Postgres and the store::

    AVATARME_BATCH_PROGRAM=models.drawing avatarme worker --name $(hostname) --batches 4 --database postgresql://...
"""

from __future__ import annotations

import contextlib
import importlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from service.batch.driver import Wanted, on_stderr
from service.batch.driver import run as run_batch
from service.batch.plan import STATE
from service.jobs.database import FileLock
from service.jobs.process import Reporter, Task
from service.places import Place, place

Order = Mapping[str, Any]

PROGRAMS = {"people": "models.people.shards", "captures": "models.training.factory"}
"""What can be drawn -> the module whose ``draw_order(order, target)`` writes one file of it."""

SUFFIX = ".npz"
_ORDERS = f"{STATE}/orders"
_LONGEST_S = 7 * 86400.0


def run(task: Task, reporter: Reporter) -> None:
    """Draw the file of one order, as the process of a photo of a batch."""
    order = json.loads(Path(task.photo).read_bytes())
    importlib.import_module(PROGRAMS[order["what"]]).draw_order(order, Path(task.output))
    reporter.done({"warnings": []})


def draw_all(orders: Mapping[str, Order], out: str, *, jobs: int = 1, database: str = "") -> bool:
    """Draw all files that are not there yet, and say how it went on standard error.

    Args:
        orders: by the name of the file, which ends with ``SUFFIX``; ``what`` is of ``PROGRAMS``.
        out: folder or address (``s3://...``) of the files.
        jobs: files at the same time on this machine.
        database: address of a Postgres whose workers draw them; "" to draw them here.

    Returns:
        Whether all files are there now.

    Raises:
        UsageError, OutputFault: as ``service.batch.driver.run``; another process draws into the folder.
    """
    target = place(out)
    with contextlib.ExitStack() as held:
        if target.folder is not None and not database:  # the orders of one call are another's to delete
            held.callback(FileLock(target.folder / STATE, "drawing").release)
        return _drawn(orders, target, jobs, database)


def _drawn(orders: Mapping[str, Order], target: Place, jobs: int, database: str) -> bool:
    there = {entry.name for entry in target.entries({SUFFIX})}
    wanted = {_order_name(name): order for name, order in orders.items() if name not in there}
    sys.stderr.write(f"{len(orders)} files, {len(orders) - len(wanted)} of them there already\n")
    source = place(f"{target.address}/{_ORDERS}")
    for entry in list(source.entries({".json"})):
        source.delete(entry.name)  # of another run, or done
    if not wanted:
        return True
    for name, order in wanted.items():
        source.write(name, json.dumps(order, sort_keys=True).encode())
    asked = Wanted(
        source=source.address, out=target.address, resume=True, database=database, jobs=jobs, timeout_s=_LONGEST_S,
        memory_mb=0, program=__name__, inputs=frozenset({".json"}), product=SUFFIX,
    )  # fmt: skip
    with on_stderr() as shown:
        tally = run_batch(asked, shown)
    for line in tally.failures:
        sys.stderr.write(f"{line['path']}: {line['error']['code']}: {line['error']['message']}\n")
    for name in wanted:
        if target.modified(str(PurePosixPath(name).with_suffix(SUFFIX))) is not None:
            source.delete(name)
    return not tally.failed and not tally.left


def _order_name(name: str) -> str:
    return str(PurePosixPath(name).with_suffix(".json"))
