"""``report.jsonl``: what became of each photo, one JSON object a line, and the ground on which ``--resume`` stands."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import secrets
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from service.errors import OutputFault, UsageError

REPORT = "report.jsonl"
_LOCK = ".batch.lock"


@dataclass(frozen=True, kw_only=True)
class Line:
    """What became of one photo.

    Attributes:
        path: the photo's name below the folder.
        sha256: of the photo.
        options: what was asked for, JSON values.
        outcome: "succeeded" or "failed".
        error: None, or ``code`` and ``message`` with the facts that the fault carries.
        archive: path below the output folder, None where there is none.
        archive_sha256: hex digest, None where there is no archive.
        seconds: wall time.
        warnings: stable codes.
        attempt: counts from 1; each new try of a photo that failed is one more.
    """

    path: str
    sha256: str
    options: Mapping[str, Any]
    outcome: Literal["succeeded", "failed"]
    error: Mapping[str, Any] | None = None
    archive: str | None = None
    archive_sha256: str | None = None
    seconds: float = 0.0
    warnings: list[str] = field(default_factory=list)
    attempt: int = 1


class Report:
    """The report of one output folder, held by one program at a time. Threads may share it.

    Args:
        out: the output folder; made where it is not there.
        resume: go on with a report that is there; without this such a report is refused, so that a slip of the
            keyboard does not do the work of days again.

    Raises:
        UsageError: another program holds the folder, or there is a report and ``resume`` is False.
        OutputFault: the folder cannot be written.
    """

    def __init__(self, out: Path, *, resume: bool) -> None:
        self.path = out / REPORT
        self._guard = threading.Lock()
        try:
            out.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(out)
            if self.path.exists() and not resume:
                raise UsageError(f"{out} has the report of an earlier run; --resume goes on with it", field="resume")
            self._lines = _read(self.path)
            self._compact()
            self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise OutputFault(f"cannot write {out}: {(error.strerror or str(error)).lower()}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def find(self, path: str) -> Line | None:
        """The last line of a photo."""
        return self._lines.get(path)

    def add(self, line: Line) -> None:
        """Append a line; it is on the disk when this returns. After :meth:`close` nothing is added any more.

        Raises:
            OutputFault: the disk is full or gone.
        """
        with self._guard:
            if self._file < 0:
                return
            try:
                os.write(self._file, _text(line))
                os.fsync(self._file)
            except OSError as error:
                raise OutputFault(f"cannot write {self.path}: {(error.strerror or str(error)).lower()}") from error
            self._lines[line.path] = line

    def close(self) -> None:
        """Leave one line a photo, in the order of their names, and let go of the folder."""
        with self._guard:
            if self._file < 0:
                return
            os.close(self._file)
            self._file = -1
            with contextlib.suppress(OSError):  # a disk that is full: the lines are there, only not in order
                self._compact()
            os.close(self._lock)

    def _compact(self) -> None:
        """Write the report anew in one step: what a killed program left half written goes, so do lines that are old."""
        part = self.path.with_name(f".{REPORT}.{secrets.token_hex(4)}.part")
        try:
            with part.open("wb") as stream:
                stream.writelines(_text(self._lines[path]) for path in sorted(self._lines))
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(self.path)
        finally:
            part.unlink(missing_ok=True)


def _read(path: Path) -> dict[str, Line]:
    """The last line of each photo; what is no line of a report (the end of one that was cut off) is left out."""
    lines: dict[str, Line] = {}
    if path.exists():
        with path.open("rb") as stream:
            for text in stream:
                line = _parsed(text)
                if line is not None:
                    lines[line.path] = line
    return lines


_KINDS: dict[str, type | tuple[type, ...]] = {
    "path": str,
    "sha256": str,
    "options": dict,
    "outcome": str,
    "archive": (str, type(None)),
    "archive_sha256": (str, type(None)),
    "attempt": int,
}


def _parsed(text: bytes) -> Line | None:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or not all(isinstance(content.get(name), kind) for name, kind in _KINDS.items()):
        return None
    known = {item.name for item in fields(Line)}
    return Line(**{name: value for name, value in content.items() if name in known})


def _text(line: Line) -> bytes:
    return json.dumps(asdict(line)).encode() + b"\n"  # ASCII: a file name need not be text


def _locked(out: Path) -> int:
    handle = os.open(out / _LOCK, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise UsageError(f"another batch writes to {out}; wait for it or name another folder", field="out") from error
    return handle
