"""``avatarme batch``: a folder of photos in, a folder of archives and a report out."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from service.batch.display import display
from service.batch.photos import Photo, find_photos
from service.batch.report import Report
from service.batch.run import Batch, Tally
from service.cli.failures import describe
from service.errors import UsageError

if TYPE_CHECKING:
    from service.batch.maker import Maker

WORK = ".work"
"""Folder in the output folder for what is on its way."""

KEY = "AVATARME_API_KEY"
"""Variable with the API key: what stands on a command line can be read by every user of the machine."""

SERVER_JOBS = 4


def batch(
    folder: str,
    out: str,
    options: Mapping[str, Any],
    *,
    server: str | None,
    jobs: int | None,
    resume: bool,
    timeout_s: float,
    keep: bool,
    head: str | None,
    as_json: bool,
) -> None:
    """Make all photos of a folder; print the path of the report, or the tally as one JSON object.

    Args:
        folder: with the photos.
        out: for archives and report.
        options: what was asked for, JSON values.
        server: address, None for this machine.
        jobs: photos at the same time; None for 4 at a server, and here one for every two processors.
        resume: go on with the report in ``out``.
        timeout_s: longest time of one photo.
        keep: leave archives on the server.
        head: head model file, for this machine only.
        as_json: print JSON.

    Raises:
        UsageError: folders, numbers or their combination cannot be right.
        ServerUnreachable, AccessDenied: there is no way to the server.
        typer.Exit: 1, some photo has no archive.
        KeyboardInterrupt: Ctrl-C.
    """
    begin = time.perf_counter()
    _check(server, jobs, timeout_s, keep, head)
    target = Path(out)
    photos = find_photos(Path(folder), target)
    with Report(target, resume=resume) as report:
        if not resume:
            _refuse_to_overwrite(photos, target)
        work = target / WORK
        work.mkdir(exist_ok=True)
        maker: Maker
        if server is None:
            from service.batch.local import LocalMaker

            maker = LocalMaker(work, head=head, timeout_s=timeout_s)
            options = options if head is None else {**options, "head": head}
        else:
            from service.batch.remote import RemoteMaker

            maker = RemoteMaker(server, os.environ.get(KEY), work, timeout_s=timeout_s, keep=keep)
        with display(len(photos)) as shown:
            tally = Batch(photos, target, options, maker, report, shown).run(jobs or default_jobs(server))
        maker.close()
        if not tally.left:
            shutil.rmtree(work, ignore_errors=True)
    _tell(tally, report.path, time.perf_counter() - begin, as_json=as_json)


def default_jobs(server: str | None) -> int:
    """Photos at the same time: a server takes its time anyway; here the stages use about two processors each."""
    if server is not None:
        return SERVER_JOBS
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, usable // 2)


def _check(server: str | None, jobs: int | None, timeout_s: float, keep: bool, head: str | None) -> None:
    if jobs is not None and not 1 <= jobs <= 256:
        raise UsageError(f"jobs is {jobs}; it has to be 1 to 256", field="jobs")
    if not 0 < timeout_s <= 7 * 86400:
        raise UsageError(f"timeout is {timeout_s:g}; it has to be above 0 and at most a week", field="timeout")
    if server is not None and head is not None:
        raise UsageError("a server has its own head model; --head and --server exclude each other", field="head")
    if server is None and keep:
        raise UsageError("--keep leaves archives on a server; name one with --server", field="keep")
    if head is not None and not Path(head).is_file():
        raise UsageError(f"there is no head model file {head}; docs/head-model.md says how one is made", field="head")


def _refuse_to_overwrite(photos: list[Photo], out: Path) -> None:
    there = next((photo.archive for photo in photos if (out / photo.archive).exists()), None)
    if there is not None:
        raise UsageError(f"{out} has a {there} already; name another folder, or --resume to replace it", field="out")


def _tell(tally: Tally, report: Path, seconds: float, *, as_json: bool) -> None:
    facts: dict[str, Any] = {"made": tally.made, "failed": tally.failed, "skipped": tally.skipped, "left": tally.left}
    words = ", ".join(f"{count} {name}" for name, count in facts.items() if count or name == "made")
    typer.echo(f"avatarme: {words}", err=True)
    if tally.ended_by is not None:
        typer.echo(f"avatarme: {tally.ended_by.message}; go on with --resume", err=True)
        facts |= describe(tally.ended_by)
    if as_json:
        typer.echo(json.dumps({"report": str(report), "seconds": round(seconds, 3), **facts}))
    else:
        typer.echo(os.fsencode(report))
    if tally.failed or tally.left:
        raise typer.Exit(1)
