"""``avatarme batch``: photos of a folder or a store in, archives and a report out."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.app import INTERRUPTED, describe
from service.cli.files import head_file
from service.cli.flags import AVATAR, Flag, Head, Json, asked, parsed, with_flags
from service.errors import AvatarError, UsageError
from service.machine import processors, variable

if TYPE_CHECKING:
    from service.batch.driver import Tally, Wanted

KEY = "AVATARME_API_KEY"
"""Variable with the API key: what stands on a command line can be read by every user of the machine."""


def _part(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise UsageError(f"shard is {text!r}; write K/N with K from 1 to N, for example 3/20", field="shard")
    return int(found[1]), int(found[2])


BATCH = {
    "server": Flag("Server that makes them; its key: AVATARME_API_KEY.", metavar="URL", envvar="AVATARME_SERVER"),
    "database": Flag("Postgres of workers on other machines that make them.", metavar="URL"),
    "jobs": Flag("Photos at the same time. [default: 4, here one for two processors]", int),
    "group_by": Flag("One avatar of the photos in a folder, or of ada-1, ada-2 ...", metavar="folder|prefix"),
    "shard": Flag("Only the K-th of N parts, for array jobs; then --resume merges.", metavar="K/N", parse=_part),
    "timeout": Flag("Longest time of one photo. [default: 1800]", float, "SECONDS"),
}
"""How a batch is made; all else is of ``make``."""


@with_flags(BATCH | AVATAR)
def batch(
    folder: Annotated[
        str, typer.Argument(metavar="IN", help="Folder with photos, in folders of its own too, or s3://")
    ],
    out: Annotated[str, typer.Argument(metavar="OUT", help="Folder or s3:// for archives and report.jsonl.")],
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the report in OUT.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Look for new photos until Ctrl-C.")] = False,
    keep: Annotated[bool, typer.Option("--keep", help="Leave archives on the server until they expire.")] = False,
    head: Head = None,
    as_json: Json = False,
    **flags: Any,
) -> None:
    """Make avatars of all photos in a folder or a store.

    Takes the options of 'make' too. Prints the path of the report, which has one JSON object for each photo. Exit
    status: 0 every photo has an archive, 1 some have not, 2 usage, 130 interrupted (go on with --resume).
    """
    from service.batch import driver
    from service.batch.plan import REPORT, grouped

    begin = time.perf_counter()
    given = parsed(BATCH, {name: flags.pop(name) for name in BATCH})
    options = asked(flags)
    if head_file(head) is not None:
        options["head"] = str(Path(str(head)).absolute())
    source, jobs = grouped(folder, given.pop("group_by", None)), given.pop("jobs", None)
    # Here the stages of a photo use about two processors; a server takes its time anyway.
    at_once = max(1, processors() // 2) if given.get("server") is None else 4
    wanted = driver.Wanted(
        source=source, out=out, options=options, jobs=jobs or at_once, resume=resume,
        watch=watch, keep=keep, timeout_s=given.pop("timeout", driver.Wanted.timeout_s),
        api_key=variable(KEY), **given,
    )  # fmt: skip
    _check(wanted, jobs, head)
    try:
        with driver.on_stderr() as shown:
            tally = driver.run(wanted, shown)
    except AvatarError as error:
        error.message = _end(error)
        raise
    except KeyboardInterrupt as interruption:
        typer.echo("avatarme: interrupted; what is finished is in the report, go on with --resume", err=True)
        if as_json:
            typer.echo(json.dumps(describe(interruption)))
        sys.stdout.flush()
        os._exit(INTERRUPTED)  # a thread that reads from a server must not keep the program alive
    _tell(tally, f"{out.rstrip('/')}/{REPORT}", time.perf_counter() - begin, as_json=as_json)


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


def _end(error: AvatarError) -> str:
    """Why a batch ended early; of a key that was refused also where keys come from."""
    whose = f"{KEY} holds no key of this server: " if error.code == "access-denied" else ""
    return whose + error.message.removesuffix(".")


def _tell(tally: Tally, report: str, seconds: float, *, as_json: bool) -> None:
    from service.batch.driver import SHOWN, printable

    for line in tally.failures:
        typer.echo(printable(f"{line['path']}: {line['error']['code']}: {line['error']['message']}"), err=True)
    if tally.failed > SHOWN:
        typer.echo(f"... and {tally.failed - SHOWN} more; the report has them all", err=True)
    facts: dict[str, Any] = {"made": tally.made, "failed": tally.failed, "skipped": tally.skipped, "left": tally.left}
    words = ", ".join(f"{count} {name}" for name, count in facts.items() if count or name == "made")
    typer.echo(f"avatarme: {words}", err=True)
    if tally.ended_by is not None:
        typer.echo(f"avatarme: {_end(tally.ended_by)}; go on with --resume", err=True)
        facts |= describe(tally.ended_by)
    if as_json:
        typer.echo(json.dumps({"report": report, "seconds": round(seconds, 3), **facts}))
    else:
        typer.echo(os.fsencode(report))
    if tally.failed or tally.left:
        raise typer.Exit(1)
