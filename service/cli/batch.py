"""``avatarme batch``: photos of a folder or a store in, archives and a report out."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path
from typing import Any

import typer

from service.batch.display import display, printable
from service.batch.driver import SHOWN, Tally, Wanted, run
from service.batch.groups import GROUPS, grouped
from service.batch.plan import REPORT
from service.cli.failures import INTERRUPTED, describe
from service.errors import UsageError

KEY = "AVATARME_API_KEY"
"""Variable with the API key: what stands on a command line can be read by every user of the machine."""

SERVER_JOBS = 4
"""Photos at the same time at a server, which takes its time anyway."""


def grouped_source(folder: str, by: str | None) -> str:
    """The source whose photos are taken together by person.

    Raises:
        UsageError: ``by`` is no way to tell.
    """
    if by is not None and by not in GROUPS:
        raise UsageError(f"group-by is {by!r}; it has to be {' or '.join(GROUPS)}", field="group_by")
    return grouped(folder if "://" in folder else str(Path(folder).absolute()), by) if by else folder


def batch(
    folder: str, out: str, options: dict[str, Any], *, jobs: int | None, shard: str | None, head: str | None,
    as_json: bool, **more: Any,
) -> None:  # fmt: skip
    """Make all photos of a place; print the path of the report, or the tally as one JSON object.

    Args:
        folder: with the photos.
        out: for archives and report.
        options: what was asked for, JSON values.
        jobs: photos at the same time; None for 4 at a server, and here one for every two processors.
        shard: "K/N" for one part of them only.
        head: head model file; not at a server.
        as_json: print JSON.
        more: further members of :class:`Wanted`.

    Raises:
        UsageError: places, numbers or their combination cannot be right.
        ServerUnreachable, AccessDenied: there is no way to the server.
        typer.Exit: 1, some photo has no archive.
    """
    begin = time.perf_counter()
    if head is not None:
        options = {**options, "head": str(Path(head).absolute())}
    wanted = Wanted(
        source=folder, out=out, options=options, jobs=jobs or default_jobs(more["server"]), shard=_part(shard),
        api_key=os.environ.get(KEY), **more,
    )  # fmt: skip
    _check(wanted, jobs, head)
    try:
        with display() as shown:
            tally = run(wanted, shown)
    except KeyboardInterrupt as interruption:
        typer.echo("avatarme: interrupted; what is finished is in the report, go on with --resume", err=True)
        if as_json:
            typer.echo(json.dumps(describe(interruption)))
        sys.stdout.flush()
        os._exit(INTERRUPTED)  # a thread that reads from a server must not keep the program alive
    _tell(tally, f"{out.rstrip('/')}/{REPORT}", time.perf_counter() - begin, as_json=as_json)


def default_jobs(server: str | None) -> int:
    """Photos at the same time: here the stages use about two processors each."""
    if server is not None:
        return SERVER_JOBS
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, usable // 2)


def _part(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise UsageError(f"shard is {text!r}; write K/N with K from 1 to N, for example 3/20", field="shard")
    return int(found[1]), int(found[2])


def _check(wanted: Wanted, jobs: int | None, head: str | None) -> None:
    if jobs is not None and not 1 <= jobs <= 256:
        raise UsageError(f"jobs is {jobs}; it has to be 1 to 256", field="jobs")
    if not 0 < wanted.timeout_s <= 7 * 86400:
        raise UsageError(f"timeout is {wanted.timeout_s:g}; it has to be above 0 and at most a week", field="timeout")
    if wanted.server is not None and head is not None:
        raise UsageError("a server has its own head model; --head and --server exclude each other", field="head")
    if wanted.server is not None and wanted.database:
        raise UsageError("--server and --database exclude each other: either computes the photos", field="database")
    if wanted.database and (jobs is not None or wanted.shard is not None):
        raise UsageError("--jobs and --shard are for this machine; workers have --batches", field="database")
    if wanted.shard is not None and wanted.watch:
        raise UsageError("--shard makes what is there now; --watch goes without it", field="watch")
    if wanted.server is None and wanted.keep:
        raise UsageError("--keep leaves archives on a server; name one with --server", field="keep")
    if head is not None and not Path(head).is_file():
        raise UsageError(f"there is no head model file {head}; docs/head-model.md says how one is made", field="head")


def _tell(tally: Tally, report: str, seconds: float, *, as_json: bool) -> None:
    for line in tally.failures:
        typer.echo(printable(f"{line['path']}: {line['error']['code']}: {line['error']['message']}"), err=True)
    if tally.failed > SHOWN:
        typer.echo(f"... and {tally.failed - SHOWN} more; the report has them all", err=True)
    facts: dict[str, Any] = {"made": tally.made, "failed": tally.failed, "skipped": tally.skipped, "left": tally.left}
    words = ", ".join(f"{count} {name}" for name, count in facts.items() if count or name == "made")
    typer.echo(f"avatarme: {words}", err=True)
    if tally.ended_by is not None:
        typer.echo(f"avatarme: {tally.ended_by.message}; go on with --resume", err=True)
        facts |= describe(tally.ended_by)
    if as_json:
        typer.echo(json.dumps({"report": report, "seconds": round(seconds, 3), **facts}))
    else:
        typer.echo(os.fsencode(report))
    if tally.failed or tally.left:
        raise typer.Exit(1)
