"""A batch: photos through a maker by several threads, each result into the report, whatever becomes of the others."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.batch.display import Display
from service.batch.local import Reported
from service.batch.maker import Hopeless, Maker, Order, Stopped
from service.batch.photos import Photo
from service.batch.report import Line, Report
from service.client.client import photo_sha256
from service.client.download import file_sha256
from service.client.errors import error_code
from service.errors import AvatarError, OutputFault

_LAST_WORDS_S = 3.0
"""How long an interrupted run waits for its threads; a thread that reads from a server may take longer, and is left."""


@dataclass
class Tally:
    """How a batch went: numbers of photos, and the fault that ended it early, if one did."""

    made: int = 0
    failed: int = 0
    skipped: int = 0
    left: int = 0
    ended_by: AvatarError | None = None
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def count(self, outcome: str) -> None:
        """One more of ``made``, ``failed`` or ``skipped``."""
        with self.lock:
            setattr(self, outcome, getattr(self, outcome) + 1)


class Batch:
    """One run over a folder.

    Args:
        photos: what to make.
        out: where archives go.
        options: what was asked for, JSON values.
        maker: makes archives.
        report: takes the lines; what it says is made and still there is skipped.
        display: shows what goes on.
    """

    def __init__(
        self,
        photos: Sequence[Photo],
        out: Path,
        options: Mapping[str, Any],
        maker: Maker,
        report: Report,
        display: Display,
    ) -> None:
        self._queue = deque(photos)
        self._out = out
        self._options = dict(options)
        self._maker = maker
        self._report = report
        self._display = display
        self._stop = threading.Event()
        self.tally = Tally()

    def run(self, jobs: int) -> Tally:
        """Work until every photo has had its turn, or nothing more can be made.

        Args:
            jobs: photos at the same time, >= 1.

        Raises:
            KeyboardInterrupt: Ctrl-C; what was finished is in the report, what was not has left nothing behind.
        """
        # Daemons: a thread that waits for a server must not keep an interrupted program alive.
        threads = [threading.Thread(target=self._work, daemon=True) for _ in range(min(jobs, len(self._queue)))]
        for thread in threads:
            thread.start()
        try:
            for thread in threads:
                while thread.is_alive():
                    thread.join(0.2)
        except KeyboardInterrupt:
            self._end()
            deadline = time.monotonic() + _LAST_WORDS_S
            for thread in threads:
                thread.join(max(0.0, deadline - time.monotonic()))
            raise
        self.tally.left = len(self._queue) + self.tally.left
        return self.tally

    def _end(self) -> None:
        self._stop.set()
        self._maker.stop()

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                photo = self._queue.popleft()
            except IndexError:
                return
            try:
                self._one(photo)
            except Stopped:
                self.tally.count("left")
            except Hopeless as end:
                self._give_up(end.error)
            except OutputFault as error:  # of the report
                self._give_up(error)

    def _give_up(self, error: AvatarError) -> None:
        self.tally.count("left")
        self.tally.ended_by = self.tally.ended_by or error
        self._end()

    def _one(self, photo: Photo) -> None:
        begin = time.perf_counter()
        self._display.begin(photo.name)
        line = None
        try:
            digest = photo_sha256(photo.path)
            before = self._report.find(photo.name)
            if before is not None and self._settled(before, digest):
                self.tally.count("skipped")
                return
            line = self._line(photo, digest, 1 if before is None else before.attempt + (before.outcome == "failed"))
        except AvatarError as error:
            line = Line(path=photo.name, sha256="", options=self._options, outcome="failed", error=_facts(error))
        finally:
            self._display.end(photo.name, line)
        seconds = round(time.perf_counter() - begin, 3)
        self._report.add(Line(**{**vars(line), "seconds": seconds}))
        self.tally.count("made" if line.outcome == "succeeded" else "failed")

    def _line(self, photo: Photo, digest: str, attempt: int) -> Line:
        """Make one photo."""
        target = self._out / photo.archive
        facts: dict[str, Any] = {
            "path": photo.name,
            "sha256": digest,
            "options": self._options,
            "attempt": attempt,
        }
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            order = Order(photo.path, photo.name, digest, self._options, attempt, target)
            warnings = self._maker.make(order, lambda stage, share: self._display.progress(photo.name, stage, share))
            made: dict[str, Any] = {"archive": photo.archive, "archive_sha256": file_sha256(target)}
        except (Stopped, Hopeless):
            raise
        except AvatarError as error:
            return Line(**facts, outcome="failed", error=_facts(_of_this_photo(error)))
        except OSError as error:
            fault = OutputFault(f"cannot write {target}: {(error.strerror or str(error)).lower()}")
            fault.__cause__ = error
            return Line(**facts, outcome="failed", error=_facts(_of_this_photo(fault)))
        except Exception as error:  # a bug must cost one photo, not the night
            message = f"{type(error).__name__}: {error}"
            return Line(**facts, outcome="failed", error={"code": "internal", "message": message})
        return Line(**facts, **made, outcome="succeeded", warnings=warnings)

    def _settled(self, line: Line, digest: str) -> bool:
        """Made before, of the same photo with the same options, and the archive is still what it was."""
        if line.outcome != "succeeded" or line.sha256 != digest or dict(line.options) != self._options:
            return False
        if line.archive is None:
            return False
        archive = self._out / line.archive
        if self._out.resolve() not in archive.resolve().parents:  # a report from elsewhere
            return False
        try:
            return os.path.isfile(archive) and file_sha256(archive) == line.archive_sha256
        except OSError:
            return False


_ABOUT_ITS_NAME = (errno.ENAMETOOLONG, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.EINVAL, errno.EILSEQ)


def _of_this_photo(error: AvatarError) -> AvatarError:
    """The fault, unless it is one of the disk, which the next photo would meet as well.

    Raises:
        Hopeless: the disk is full, read-only or gone.
    """
    cause = error.__cause__
    if isinstance(error, OutputFault) and not (isinstance(cause, OSError) and cause.errno in _ABOUT_ITS_NAME):
        raise Hopeless(error)
    return error


def _facts(error: AvatarError) -> dict[str, Any]:
    code = error.reported_code if isinstance(error, Reported) else error_code(error)
    return {**error.extra, "code": code, "message": error.message}
