"""Moments of a service at work, seen in the log that the toy job writes: when to kill what.

A line of the log is ``JOB begin|kept STAGE PROCESS``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from tests.support.toy_job import STAGES

POINTS = ("taking in", *STAGES, "publishing", "starting")
"""Where the kills meet the service, in turn: in the request, in each stage, after the last one, after a start."""


def reached(point: str, log: Path, asked: Callable[[], int], within: float = 60.0) -> str | None:
    """Wait until the service comes to a point.

    Args:
        point: one of ``POINTS``.
        log: of the toy job.
        asked: says how many requests were begun so far.
        within: seconds.

    Returns:
        The line of the log that tells it, "" for a point that no line tells; None where it does not come there
        within the time.
    """
    if point == "starting":
        return ""
    mark = {"publishing": f" kept {STAGES[-1]} "}.get(point, f" begin {point} ")
    before, known, deadline = _size(log), asked(), time.monotonic() + within
    while time.monotonic() < deadline:
        if point == "taking in":
            if asked() > known:
                return ""
        elif _size(log) > before:
            with log.open("rb") as stream:
                stream.seek(before)
                lines = stream.read().decode("ascii").splitlines()
            for line in lines:
                if mark in line:
                    return line
        time.sleep(0.005)
    return None


def redone(log: Path) -> list[str]:
    """Stages that began again after they had been kept."""
    kept: set[str] = set()
    again = []
    for line in log.read_text("ascii").splitlines() if log.exists() else ():
        job, what, stage, _ = line.split()
        if what == "kept":
            kept.add(f"{job} {stage}")
        elif f"{job} {stage}" in kept:
            again.append(f"{job} {stage}")
    return again


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
