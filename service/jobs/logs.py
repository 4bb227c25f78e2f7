"""Logs as one JSON object a line, without photos, file names, keys or addresses of people."""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import sys
import threading
import time
from typing import Any

_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "color_message"}

MOST_WAITING = 20_000
"""Lines that may wait to be written."""

PATIENCE = 2.0
"""Seconds that the end of a process waits for its last lines."""


class JsonFormatter(logging.Formatter):
    """``time``, ``level``, ``logger``, ``message``, fields given as ``extra``, ``traceback`` of an exception."""

    def format(self, record: logging.LogRecord) -> str:
        """One line of JSON."""
        moment = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        entry: dict[str, Any] = {
            "time": f"{moment}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        entry |= {name: value for name, value in vars(record).items() if name not in _STANDARD}
        if record.exc_info:
            entry["traceback"] = self.formatException(record.exc_info)
        return json.dumps(entry, default=str)


def is_cancellation(record: logging.LogRecord) -> bool:
    """Whether the queue's library tells of a job that its owner cancelled, as of an error; our own line tells that."""
    kind = record.exc_info[0] if record.exc_info else None
    return record.name == "dbos" and kind is not None and kind.__name__.endswith("WorkflowCancelledError")


class Background(logging.Handler):
    """Writes in a thread of its own, so that nobody waits for a reader of the log that is slow or has stopped.

    What does not fit into the queue is left out and counted. A record of level CRITICAL is waited for a little, as the
    process may end right after it.
    """

    def __init__(self) -> None:
        super().__init__()
        self._waiting: queue.SimpleQueue[logging.LogRecord | threading.Event] = queue.SimpleQueue()
        self._lost = 0
        threading.Thread(target=self._write, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Hand a record to the thread."""
        if is_cancellation(record):
            return
        if self._waiting.qsize() >= MOST_WAITING:
            self._lost += 1
            return
        self._waiting.put(record)
        if record.levelno >= logging.CRITICAL:
            self.flush()

    def flush(self) -> None:
        """Wait until everything before is written, but no longer than ``PATIENCE``."""
        written = threading.Event()
        self._waiting.put(written)
        written.wait(PATIENCE)

    def _write(self) -> None:
        while True:
            entry = self._waiting.get()
            if isinstance(entry, threading.Event):
                entry.set()
                continue
            lines = [self._line(entry)]
            if self._lost:
                lost, self._lost = self._lost, 0
                words = {"level": "warning", "logger": __name__, "message": f"{lost} lines of the log were left out"}
                lines.append(json.dumps(words))
            stream = sys.stderr  # None where it was closed before this process began
            if stream is not None:
                with contextlib.suppress(OSError, ValueError):
                    stream.write("".join(line + "\n" for line in lines))
                    stream.flush()

    def _line(self, record: logging.LogRecord) -> str:
        try:
            return self.format(record)
        except Exception as error:  # a mistake in the words of a message must not end the log
            return json.dumps({"level": "error", "logger": __name__, "message": f"{record.msg!r}: {error!r}"})


def set_up() -> None:
    """Send all logs to standard error as JSON; a standard error that is gone or full is no reason to stop."""
    global _handler
    if _handler is None:
        _handler = Background()
        _handler.setFormatter(JsonFormatter())
    logging.raiseExceptions = False
    root = logging.getLogger()
    root.handlers[:] = [_handler]
    root.setLevel(logging.INFO)
    for name in ("dbos", "uvicorn", "uvicorn.error", "uvicorn.access"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
    logging.getLogger("dbos").setLevel(logging.WARNING)
    for name in ("httpx", "httpcore"):  # they would write down whom a webhook goes to
        logging.getLogger(name).setLevel(logging.WARNING)
    logging.getLogger("uvicorn.access").setLevel(logging.WARNING)


def flush() -> None:
    """Write what waits, before an end of the process that runs nothing else any more."""
    if _handler is not None:
        _handler.flush()


_handler: Background | None = None
