"""What a batch shows on standard error: bars on a terminal, else a line for each photo that is finished."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

import typer

from service.batch.report import Line

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Display(Protocol):
    """Told what goes on, by several threads."""

    def begin(self, name: str) -> None:
        """A photo has its turn."""
        ...

    def progress(self, name: str, stage: str, share: float) -> None:
        """A stage of it begins; ``share`` of the work is done."""
        ...

    def end(self, name: str, line: Line | None) -> None:
        """It is finished; None where nothing was to be done."""
        ...


@contextmanager
def display(total: int) -> Iterator[Display]:
    """The display that fits standard error. Colour obeys NO_COLOR."""
    if not sys.stderr.isatty():
        yield Lines(total)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    console = Console(stderr=True, highlight=False)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[stage]}", markup=False),
        TimeElapsedColumn(),
    )
    with Bars(*columns, console=console, transient=True) as bars:
        yield OnTerminal(bars, total)


class Lines:
    """A line for each finished photo."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._done = 0
        self._lock = threading.Lock()

    def begin(self, name: str) -> None:
        """See ``Display.begin``."""

    def progress(self, name: str, stage: str, share: float) -> None:
        """See ``Display.progress``."""

    def end(self, name: str, line: Line | None) -> None:
        """See ``Display.end``."""
        with self._lock:
            self._done += 1
            if line is not None:
                typer.echo(f"[{self._done}/{self._total}] {summary(line)}", err=True)


class OnTerminal:
    """One bar for all photos and one for each that is being made; faults stay above them."""

    def __init__(self, bars: Progress, total: int) -> None:
        self._bars = bars
        self._all = bars.add_task("photos", total=total, stage="")
        self._tasks: dict[str, TaskID] = {}

    def begin(self, name: str) -> None:
        """See ``Display.begin``."""
        self._tasks[name] = self._bars.add_task(printable(name)[-40:], total=100, stage="")

    def progress(self, name: str, stage: str, share: float) -> None:
        """See ``Display.progress``."""
        self._bars.update(self._tasks[name], completed=round(100 * min(max(share, 0.0), 1.0)), stage=stage)

    def end(self, name: str, line: Line | None) -> None:
        """See ``Display.end``."""
        self._bars.remove_task(self._tasks.pop(name))
        self._bars.advance(self._all)
        if line is not None and line.outcome == "failed":
            self._bars.console.print(summary(line), markup=False)


def summary(line: Line) -> str:
    """A photo's fate in one line."""
    words = "done"
    if line.error is not None:
        words = f"{line.error['code']}: {line.error['message']}"
    elif line.warnings:
        words = f"done, with warnings: {', '.join(line.warnings)}"
    return printable(f"{line.path}: {words}")


def printable(text: str) -> str:
    """Text that is safe on a terminal: names and messages come from files and servers, and may hold control codes."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)
