"""Moments of a service at work, seen in the log that the toy job writes: when to kill what.

A line of the log is ``JOB begin|kept STAGE PROCESS``. The pipeline itself writes no log; it is followed by the files of
its kept stages.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path

from tests.support.toy_job import STAGES

POINTS = ("taking in", *STAGES, "publishing", "starting")
"""Where the kills meet the service, in turn: in the request, in each stage, after the last one, after a start."""

REAL_STAGES = (
    "decode", "detect", "read", "fit", "hair", "texture", "compare",
    "diffuse_albedo", "specular_albedo", "specular_normal", "diffuse_normal", "displacement",
)  # fmt: skip
"""What a job of the pipeline keeps at draft, in this order; after the last its archive is packed."""


def kept_stages(data: Path) -> set[tuple[str, str]]:
    """(job, stage) of all results on the disk.

    Args:
        data: folder of the service.
    """
    found = set()
    with contextlib.suppress(OSError):
        for job in os.scandir(data / "artifacts"):
            with contextlib.suppress(OSError):
                names = [name for name in os.listdir(job.path) if name.startswith("stage_")]
                found |= {(job.name, name.removeprefix("stage_").partition("-")[0]) for name in names}
    return found


def really_reached(point: str, data: Path, asked: Callable[[], int], within: float = 60.0) -> str | None:
    """As :func:`reached`, of a service with the pipeline itself.

    Args:
        point: "taking in", "starting", or the stage whose result is to be kept next.
        data: folder of the service.
        asked: says how many requests were begun so far.
        within: seconds.
    """
    if point == "starting":
        return ""
    before, known, deadline = kept_stages(data), asked(), time.monotonic() + within
    while time.monotonic() < deadline:
        if point == "taking in" and asked() > known:
            return ""
        if point != "taking in" and any(stage == point for _, stage in kept_stages(data) - before):
            return point
        time.sleep(0.005)
    return None


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
