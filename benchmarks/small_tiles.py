"""Memory and time of a job's first attempt, and of the one after it that has to get by with less memory.

    python -m benchmarks.small_tiles PHOTO [--quality standard] [--memory-mb 8192]

Each runs as the service runs it, in a process of its own with its limits and with finished stages kept on the disk, but
without a server. ``memory_mb`` is the most private memory, looked at every 0.2 s, which is what ``MEMORY_MB`` limits.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from service.jobs.child import options_from
from service.jobs.process import JobProcess, descendants, resident_mb
from service.jobs.settings import Settings
from service.jobs.wire import Task


def run(photo: Path, options: dict[str, Any], memory_mb: int, *, tight: bool) -> dict[str, Any]:
    """One attempt on an empty disk, from the task to the archive."""
    folder = Path(tempfile.mkdtemp(prefix="small-tiles-"))
    try:
        scratch = folder / "scratch"
        scratch.mkdir()
        process = JobProcess(Settings(data=folder, memory_mb=memory_mb, job_seconds=7200.0, niceness=0))
        task = Task(
            job="0" * 32, photo=str(photo), options=options,
            photo_sha256=hashlib.sha256(photo.read_bytes()).hexdigest(),
            artifacts=f"file://{folder}/artifacts", output=str(folder / "archive.zip"), scratch=str(scratch),
            tight=tight,
        )  # fmt: skip
        most = 0.0

        def look() -> bool:
            nonlocal most
            processes = [process._process.pid, *descendants(process._process.pid)]
            most = max(most, sum(resident_mb(one) for one in processes))
            return False

        begin, load, before = time.monotonic(), os.getloadavg()[0], resource.getrusage(resource.RUSAGE_CHILDREN)
        ending = process.run(task, lambda message: None, look)
        seconds, after = time.monotonic() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        slowest = sorted(ending.facts.get("timings", {}).items(), key=lambda item: -item[1])[:4]
        return {
            "tiles": "small" if tight else "default", "ending": ending.kind, "code": ending.facts.get("code"),
            "seconds": round(seconds, 1), "processor_s": round(processor, 1), "memory_mb": round(most),
            "load_before": round(load, 1), "warnings": ending.facts.get("warnings"),
            "slowest": {name: round(value, 1) for name, value in slowest},
        }  # fmt: skip
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photo", type=Path)
    parser.add_argument("--quality", default="standard")
    parser.add_argument("--memory-mb", type=int, default=8192)
    asked = parser.parse_args(arguments)
    options = options_from({"quality": asked.quality, "face": "largest"}).to_json()
    for tight in (False, True):
        print(json.dumps(run(asked.photo.resolve(), options, asked.memory_mb, tight=tight)), flush=True)


if __name__ == "__main__":
    main()
