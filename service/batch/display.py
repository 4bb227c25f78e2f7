"""What a batch shows on standard error: a bar on a terminal, else a line now and then, and at the end what failed."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

EVERY_S = 10.0
"""Seconds between two lines where standard error is no terminal."""


Display = Callable[[int, int, int, float], None]
"""Told how many photos of a round are made and have failed, of how many, after how many seconds."""


@contextmanager
def display() -> Iterator[Display]:
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
