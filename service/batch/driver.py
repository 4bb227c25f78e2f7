"""A batch from its start to its report: what is to be made, who makes it, how far it is.

``place --plan--> shards --> threads here, or a queue and workers elsewhere --> reports of shards --merge--> report``
"""

from __future__ import annotations

import contextlib
import logging
import queue
import secrets
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import sqlalchemy as sa
import typer

from service.batch.makers import Hopeless, LocalMaker, Maker, RemoteMaker
from service.batch.plan import ARCHIVE, SETTLED_S, STATE, SUFFIXES, Grouped, Line, Plan, photos_at
from service.batch.shards import Rounds, Shards, lasting
from service.errors import AvatarError, Crashed, UsageError
from service.jobs.database import SHARDS, FileLock, connect, create_tables
from service.jobs.settings import Settings
from service.places import Place, place, writable

log = logging.getLogger(__name__)

POLL_S = 1.0
"""Seconds between two looks at how far a round is."""

WATCH_S = 10.0
"""Seconds between two looks for new photos."""

LAST_WORDS_S = 3
"""How long an interrupted run waits for its threads; one that reads from a server may take longer, and is left."""

SHOWN = 20
"""Photos that failed that are listed; the report has all."""


EVERY_S = 10.0
"""Seconds between two lines where standard error is no terminal."""


Display = Callable[[int, int, int, float], None]
"""Told how many photos of a round are made and have failed, of how many, after how many seconds."""


@contextmanager
def on_stderr() -> Iterator[Display]:
    """The display that fits standard error. Colour obeys NO_COLOR."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (BarColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True, highlight=False), transient=True) as bars:
        bar = bars.add_task("", total=None)

        def show(made: int, failed: int, photos: int, seconds: float) -> None:
            words = progress_words(made, failed, photos, seconds)
            bars.update(bar, total=photos, completed=made + failed, description=words)

        yield show


def _lines() -> Display:
    """A line at the beginning, every ``EVERY_S`` and at the end of a round."""
    following = 0.0

    def show(made: int, failed: int, photos: int, seconds: float) -> None:
        nonlocal following
        if time.monotonic() >= following or made + failed == photos:
            following = time.monotonic() + EVERY_S
            typer.echo(f"avatarme: {progress_words(made, failed, photos, seconds)}", err=True)

    return show


def progress_words(made: int, failed: int, photos: int, seconds: float) -> str:
    """How far a round is: photos, rate, time left, failures."""
    done = made + failed
    words = [f"{done} of {photos} photos"]
    if done and seconds > 0:
        words.append(f"{60 * done / seconds:.1f} a minute")
        if done < photos:
            words.append(f"{duration((photos - done) * seconds / done)} left")
    if failed:
        words.append(f"{failed} failed")
    return ", ".join(words)


def duration(seconds: float) -> str:
    """Time in the largest unit that makes sense: "40 s", "12 min", "3.5 h", "2.1 days"."""
    for size, unit, digits in ((86400.0, "days", 1), (3600.0, "h", 1), (60.0, "min", 0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.{digits}f} {unit}"
    return f"{seconds:.0f} s"


def printable(text: str) -> str:
    """Text that is safe on a terminal: names and messages come from files and servers, and may hold control codes."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A batch as it is asked for.

    Attributes:
        source: folder or URL of the photos.
        out: folder or URL for archives and report.
        options: of ``make``, JSON values; ``head`` names another head model file.
        resume: go on with what is there.
        watch: look for new photos until somebody ends it.
        shard: (K, N): only the K-th of N parts, without a common report; None for all.
        database: of workers on other machines; "" to compute here, or at ``server``.
        server: address, with ``api_key`` and ``keep`` as of :class:`RemoteMaker`; None for none.
        jobs: photos at the same time, where they are not computed by workers elsewhere.
        timeout_s: longest time of one photo there.
        memory_mb: most memory of one photo in MiB where it is made here, 0 for no limit of ours.
        program: module that makes a photo here; tests put a small one in place of the pipeline.
        inputs, product: suffixes of the files that count as photos, and of what is made of each.
    """

    source: str
    out: str
    options: Mapping[str, Any] = field(default_factory=dict)
    resume: bool = False
    watch: bool = False
    shard: tuple[int, int] | None = None
    database: str = ""
    server: str | None = None
    api_key: str | None = None
    keep: bool = False
    jobs: int = 1
    timeout_s: float = 1800.0
    memory_mb: int = Settings.memory_mb
    program: str = Settings.program
    inputs: frozenset[str] = SUFFIXES
    product: str = ARCHIVE


@dataclass(frozen=True)
class Tally:
    """How a batch went: numbers of photos, those that failed (the first of them), and what ended it early."""

    made: int = 0
    failed: int = 0
    skipped: int = 0
    left: int = 0
    failures: tuple[Line, ...] = ()
    ended_by: AvatarError | None = None


def run(wanted: Wanted, display: Display) -> Tally:
    """Make a batch; ``display`` is shown how far it is.

    Raises:
        UsageError: the places or their combination cannot be right.
        OutputFault: the report cannot be written.
        ServerUnreachable, AccessDenied: there is no way to the server.
        KeyboardInterrupt: Ctrl-C; what was finished is in the report, what was not has left nothing behind.
    """
    source, out = photos_at(wanted.source), place(wanted.out)
    if source.missing if isinstance(source, Grouped) else source.folder is not None and not source.folder.is_dir():
        raise UsageError(f"there is no folder {wanted.source}; name one with photos in it", field="folder")
    with writable(out), _work(out, alone=wanted.shard is None) as work:
        plan = Plan(source, out, wanted.inputs, wanted.product)
        photos = plan.look(own=wanted.shard, settled=_settled(wanted))
        if not photos and not wanted.watch and wanted.shard is None:
            raise UsageError(f"there is no photo in {wanted.source}; they end with {', '.join(sorted(wanted.inputs))}")
        if not wanted.resume and wanted.shard is None:
            plan.refuse()
        engine = BatchEngine(wanted, work)  # first: where the server is away, nothing tells of a batch
        try:
            plan.ask(wanted.options)
            return _rounds(wanted, plan, engine, photos, display)
        finally:
            engine.close()
            if wanted.shard is None:
                plan.merge(work)


def _rounds(wanted: Wanted, plan: Plan, engine: BatchEngine, photos: int, display: Display) -> Tally:
    """One round, or one after the other where the place of the photos is watched."""
    skipped: int | None = None
    while True:
        name = f"{time.time_ns() // 1_000_000:013d}-{secrets.token_hex(4)}"
        counts = plan.write_shards(name)
        skipped = photos - sum(counts) if skipped is None else skipped
        if counts:
            engine.make(name, plan.out, counts, display)
        plan.gather()
        if not wanted.watch or engine.ended_by is not None:
            made, failed, left = plan.outcome()
            return Tally(made - skipped, failed, skipped, left, tuple(plan.failures(SHOWN)), engine.ended_by)
        plan.merge(engine.work)
        time.sleep(WATCH_S)
        plan.look(settled=_settled(wanted))


def _settled(wanted: Wanted) -> float | None:
    return time.time() - SETTLED_S if wanted.watch else None


class BatchEngine:
    """Has rounds of shards computed: by threads of this process, here or at a server, or by workers elsewhere."""

    def __init__(self, wanted: Wanted, work: Path) -> None:
        self.work = work
        self.ended_by: AvatarError | None = None
        self._stopping = threading.Event()
        settings = Settings(
            data=work, database=wanted.database, worker="batch", program=wanted.program,
            job_seconds=wanted.timeout_s, niceness=0, memory_mb=wanted.memory_mb,
        )  # fmt: skip
        self._maker: Maker | None = None
        if wanted.server is not None:
            # Half a download stays for the next run, where the archives go to a disk.
            kept = work.parent / "downloads" if work.parent.name == STATE else work
            kept.mkdir(exist_ok=True)
            keep, seconds = wanted.keep, wanted.timeout_s
            self._maker = RemoteMaker(wanted.server, wanted.api_key, kept, timeout_s=seconds, keep=keep)
        elif not wanted.database:
            self._maker = LocalMaker(settings)
        self._database = connect(settings.database_url)
        self._rounds, self._queue = Rounds(self._database), None
        self._waiting: queue.SimpleQueue[tuple[str, str, int]] = queue.SimpleQueue()
        if self._maker is None:
            from service.jobs.queue import Queue

            try:
                lasting(lambda: create_tables(self._database, settings))
            except Hopeless as end:
                raise end.error from end
            self._queue = Queue(self._database)
            return
        SHARDS.create(self._database)
        self._shards = Shards(self._rounds, self._maker, work / "photos", self._stopping, self._give_up)
        for _ in range(wanted.jobs):
            threading.Thread(target=self._work, args=(self._shards,), daemon=True).start()

    def _work(self, shards: Shards) -> None:
        """Make shards that wait, one after the other."""
        while not self._stopping.is_set():
            try:
                shards.run(*self._waiting.get())
            except Exception as error:  # a mistake of ours must end the batch, not leave it waiting
                log.error("a shard failed", exc_info=error)
                self._give_up(Crashed(f"a shard failed: {type(error).__name__}: {error}"))

    def make(self, name: str, out: Place, counts: list[int], display: Display) -> None:
        """Have a round computed, and wait for its end."""
        begin, photos = time.monotonic(), sum(counts)
        try:
            lasting(lambda: self._rounds.put(self._queue, name, out.address, counts))
            if self._maker is not None:
                for number in range(len(counts)):
                    self._waiting.put((out.address, name, number))
            while True:
                done, failed, unfinished = lasting(lambda: self._rounds.tally(name))
                display(done, failed, photos, time.monotonic() - begin)
                if not unfinished:
                    lasting(lambda: self._rounds.forget(self._queue, name, len(counts)))
                if not unfinished or self.ended_by is not None:
                    return
                self._stopping.wait(min(POLL_S, POLL_S / 10 + 0.1 * (time.monotonic() - begin)))
        except Hopeless as end:
            self._give_up(end.error)
        except KeyboardInterrupt:
            self._stopping.set()
            with contextlib.suppress(sa.exc.SQLAlchemyError):
                self._rounds.call_off(name)
            raise

    def close(self) -> None:
        """End what computes here, and let go of the database."""
        self._stopping.set()
        if self._maker is not None:
            deadline = time.monotonic() + LAST_WORDS_S
            while self._shards.running and time.monotonic() < deadline:
                time.sleep(POLL_S / 10)
            self._maker.close()
        if self._queue is not None:
            self._queue.client.destroy()
        self._database.dispose()

    def _give_up(self, error: AvatarError) -> None:
        self.ended_by = self.ended_by or error
        self._stopping.set()


@contextmanager
def _work(out: Place, *, alone: bool) -> Iterator[Path]:
    """A folder for files on their way: on the disk of the archives, where that is one.

    With ``alone`` another batch that writes there is a UsageError.
    """
    if out.folder is None:
        with tempfile.TemporaryDirectory(prefix="avatarme-batch-") as folder:
            yield Path(folder)
        return
    state = out.folder / STATE
    state.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held:
        if alone:
            held.callback(FileLock(state, "batch").release)
            for left in state.glob("work*"):  # of a run that was killed
                shutil.rmtree(left, ignore_errors=True)
        work = tempfile.TemporaryDirectory(prefix="work", dir=state, ignore_cleanup_errors=True)
        yield Path(held.enter_context(work))
