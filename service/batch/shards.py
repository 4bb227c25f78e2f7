"""A shard: up to a hundred photos, one after the other, each in a process of its own, and their report.

Where workers on other machines make them, each is a workflow of DBOS on a queue of its own: it goes to whoever has a
hand free, and to another worker where that one dies. What is finished shows in the archives and in the shard's report,
which is written anew after each photo: so the next worker goes on at the same photo, and one that was frozen meanwhile
and comes back does no harm.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import sqlalchemy as sa

from service.batch.makers import Hopeless, Maker, Order, Stopped
from service.batch.plan import ASKED, Line, manifest_name, photos_at, read_lines, report_name, text_of
from service.client.errors import error_code
from service.errors import AvatarError, Crashed, OutputFault, UnreadableInput
from service.jobs.database import FAULTS, SHARDS, patient
from service.jobs.process import Glance
from service.places import Place, StoreFault, file_sha256, place, sha256_of

if TYPE_CHECKING:  # they load DBOS, which a batch on one machine does without
    from service.jobs.queue import Queue
    from service.jobs.workflow import Workflows

log = logging.getLogger(__name__)

T = TypeVar("T")

QUEUE = "batches"
WORKFLOW = "batch-shard"

LOSSES = 5
"""How often in a row a worker may be lost with the same photo before the photo is left out as the cause."""

LOOK_S = 2.0
"""Seconds between two looks whether a round goes on."""


class Rounds:
    """The shards of all rounds, in the database that the queue is in, or in one for this alone."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def put(self, queue: Queue | None, name: str, out: str, counts: Sequence[int]) -> None:
        """Begin a round, whose shards have so many photos each.

        ``queue`` is that of the workers elsewhere; None where the shards are made in this process.
        """
        with self._engine.begin() as connection:
            numbers = enumerate([0, *counts], -1)
            rows = [{"round": name, "number": number, "photos": count} for number, count in numbers]
            connection.execute(sa.insert(SHARDS), rows)
            if queue is not None:
                for number in range(len(counts)):
                    queue.enqueue(connection, QUEUE, WORKFLOW, workflow_id(name, number), number + 1, out, name, number)

    def begin(self, name: str, number: int, at: int) -> int:
        """A photo of a shard has its turn; returns how often a worker was lost with it."""
        same = SHARDS.c.at == at
        values = {"at": at, "losses": sa.case((same, SHARDS.c.losses + 1), else_=0)}
        return int(self._set(name, number, **values) or 0)

    def told(self, name: str, number: int, lines: Mapping[str, Line], *, ended: bool = False) -> None:
        """A shard got on."""
        made = sum(line["outcome"] == "succeeded" for line in lines.values())
        self._set(name, number, done=made, failed=len(lines) - made, ended=ended)

    def goes_on(self, name: str) -> bool:
        """Whether a round has not been called off."""
        with self._engine.connect() as connection:
            query = sa.select(SHARDS.c.ended).where(SHARDS.c.round == name, SHARDS.c.number == -1)
            return connection.execute(query).scalar_one_or_none() is False

    def call_off(self, name: str) -> None:
        """Let a round end: its shards that wait end when their turn comes, those that run after a moment."""
        self._set(name, -1, ended=True)

    def tally(self, name: str) -> tuple[int, int, int]:
        """Photos of a round that have an archive, that failed, and shards that have not ended."""
        columns = (SHARDS.c.done, SHARDS.c.failed, sa.case((SHARDS.c.ended, 0), else_=1))
        query = sa.select(*(sa.func.coalesce(sa.func.sum(column), 0) for column in columns))
        with self._engine.connect() as connection:
            row = connection.execute(query.where(SHARDS.c.round == name, SHARDS.c.number >= 0)).one()
        return int(row[0]), int(row[1]), int(row[2])

    def forget(self, queue: Queue | None, name: str, count: int) -> None:
        """Forget a round of so many shards that has ended."""
        if queue is not None:
            queue.delete([workflow_id(name, number) for number in range(count)])
        with self._engine.begin() as connection:
            connection.execute(sa.delete(SHARDS).where(SHARDS.c.round == name))

    def _set(self, name: str, number: int, **values: Any) -> int | None:
        query = sa.update(SHARDS).where(SHARDS.c.round == name, SHARDS.c.number == number).values(**values)
        with self._engine.begin() as connection:
            return connection.execute(query.returning(SHARDS.c.losses)).scalar_one_or_none()


def workflow_id(name: str, number: int) -> str:
    """Id of the workflow of a shard."""
    return f"{name}-{number:06d}"


@dataclass(frozen=True)
class Asked:
    """What a batch asks for: the place of its photos, JSON values of options, and since when, seconds since 1970.

    Archives that are older were made with other options.
    """

    source: Place
    options: Mapping[str, Any]
    since: float

    @classmethod
    def read(cls, out: Place) -> Asked:
        """What is asked for in a place of archives."""
        content = json.loads(out.read(ASKED))
        return cls(photos_at(content["source"]), content["options"], out.modified(ASKED) or 0.0)


@dataclass(eq=False)
class Shards:
    """Makes shards on this machine.

    Attributes:
        rounds: where they are counted.
        maker: makes archives.
        scratch: folder for files on their way; on the file system of the archives, where that is a disk.
        stopping: set when this process is to end.
        gave_up: told why no photo can be made here, whichever it is.
        running: round and number of those that are being made.
    """

    rounds: Rounds
    maker: Maker
    scratch: Path
    stopping: threading.Event
    gave_up: Callable[[AvatarError], None]
    running: set[tuple[str, int]] = field(default_factory=set, init=False)

    def workflows(self, most: int, look_s: float) -> Workflows:
        """What DBOS is to know: the workflow, and the limits of its queue, for so many shards at a time."""
        from dbos import DBOS

        from service.jobs.workflow import RECOVERIES, Workflows

        def register() -> None:
            @DBOS.step(name="photos")
            def photos(out: str, name: str, number: int) -> str:
                ending = self.run(out, name, number)
                while self.stopping.is_set():  # for the end of this process: it goes on elsewhere, or after the start
                    time.sleep(1.0)
                return ending

            @DBOS.workflow(name=WORKFLOW, max_recovery_attempts=RECOVERIES)
            def shard(out: str, name: str, number: int) -> str:
                return photos(out, name, number)

        return Workflows(register, {QUEUE: {"worker_concurrency": most, "polling_interval_sec": look_s}})

    def run(self, out: str, name: str, number: int) -> str:
        """Make what is not made yet of a shard: "made", "called off", or "stopped" where this process ends."""
        ending = "stopped"
        self.running.add((name, number))
        try:
            ending = self._run(place(out), name, number)
        except Stopped:
            pass
        except Hopeless as end:
            self.gave_up(end.error)
        finally:
            self.running.discard((name, number))
        return ending

    def _run(self, target: Place, name: str, number: int) -> str:
        called_off = Glance(lambda: not lasting(lambda: self.rounds.goes_on(name)), LOOK_S)

        def stop() -> bool:
            return self.stopping.is_set() or called_off()

        if not lasting(lambda: target.exists(ASKED)):
            return "called off"  # somebody has cleared the place
        asked = lasting(lambda: Asked.read(target))
        photos = lasting(lambda: list(read_lines(target, manifest_name(name, number))))
        lines = lasting(lambda: _report(target, name, number))
        for at, photo in enumerate(photos):
            if stop():
                break
            if photo["path"] not in lines:
                losses = lasting(partial(self.rounds.begin, name, number, at))
                line = self._line(target, asked, photo, losses, stop)
                # Read anew: another worker may have taken this one for dead and gone on.
                lines = lasting(lambda: _report(target, name, number)) | {photo["path"]: line}
                text = b"".join(text_of(lines[path]) for path in sorted(lines, key=os.fsencode))
                lasting(partial(target.write, report_name(name, number), text))
                lasting(partial(self.rounds.told, name, number, lines))
        ended = len(lines) == len(photos)
        lasting(lambda: self.rounds.told(name, number, lines, ended=ended))
        return "made" if ended else "stopped" if self.stopping.is_set() else "called off"

    def _line(self, target: Place, asked: Asked, photo: Line, losses: int, stop: Callable[[], bool]) -> Line:
        """Make one photo; returns what became of it. Stopped, Hopeless: as ``Maker.make``."""
        begin = time.perf_counter()
        scratch = self.scratch / secrets.token_hex(8)
        scratch.mkdir(parents=True)
        line: Line = {
            "path": photo["path"], "sha256": "", "options": asked.options, "outcome": "failed", "error": None,
            "archive": None, "archive_sha256": None, "seconds": 0.0, "warnings": [], "attempt": photo["attempt"],
        }  # fmt: skip
        try:
            if losses >= LOSSES:
                raise Crashed(f"the worker went down {losses} times in a row while it made this photo")
            local = _fetched(asked.source, photo["path"], scratch)
            line["sha256"] = file_sha256(local)
            there = lasting(lambda: target.modified(photo["archive"]))
            if there is not None and there >= max(photo["modified"], asked.since):
                # A worker was lost after it had made the archive and before it had said so.
                line["archive_sha256"] = lasting(lambda: _sha256(target, photo["archive"]))
            else:
                order = Order(
                    local, photo["path"], line["sha256"], asked.options, photo["attempt"], scratch / "archive.zip"
                )
                line["warnings"] = self.maker.make(order, stop)
                line["archive_sha256"] = file_sha256(order.target)
                lasting(lambda: target.put(order.target, photo["archive"]))
            line |= {"outcome": "succeeded", "archive": photo["archive"]}
        except (Stopped, Hopeless):
            raise
        except AvatarError as error:
            line["error"] = {**error.extra, "code": error_code(error), "message": error.message}
        except OSError as error:  # about the name of this photo or of its archive
            words = f"{photo['path']}: {(error.strerror or str(error)).lower()}"
            line["error"] = {"code": OutputFault.code, "message": words}
        except Exception as error:  # a bug must cost one photo, not the night
            log.error("a photo of a batch failed", exc_info=error)
            line["error"] = {"code": "internal", "message": f"{type(error).__name__}: {error}"}
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
        line["seconds"] = round(time.perf_counter() - begin, 3)
        return line


_ABOUT_A_NAME = (errno.ENAMETOOLONG, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.EINVAL, errno.EILSEQ)


def lasting(call: Callable[[], T]) -> T:
    """Call again and again while the database or a remote store fails.

    Hopeless: it failed for ``PATIENCE`` seconds, or a disk is full, read-only or gone. OSError: something is wrong with
    a name, which is one photo's own matter.
    """

    def end(error: Exception) -> NoReturn:
        raise Hopeless(OutputFault(f"database or store cannot be reached: {error}")) from error

    try:
        return patient(call, (StoreFault, *FAULTS), end)
    except OSError as error:
        if error.errno in _ABOUT_A_NAME:
            raise
        raise Hopeless(OutputFault(f"cannot read or write: {(error.strerror or str(error)).lower()}")) from error


def _fetched(source: Place, name: str, scratch: Path) -> Path:
    """Path of a photo on this machine; UnreadableInput where it is not there (any more) or must not be read."""

    def fetch() -> Path:
        try:
            return source.local(name, scratch)
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
            raise UnreadableInput(f"cannot read {name}: {error.strerror or 'it is not there any more'}") from error

    return lasting(fetch)


def _report(target: Place, name: str, number: int) -> dict[str, Line]:
    return {line["path"]: line for line in read_lines(target, report_name(name, number))}


def _sha256(where: Place, name: str) -> str:
    with where.open(name) as stream:
        return sha256_of(stream)
