"""The whole program from process start to written archive: ``python -m benchmarks.end_to_end PHOTO``.

Prints wall and processor seconds and the main process's peak resident memory (lowest, median, highest of the runs), the
seconds of each stage in the last run, the load of the machine before, and the modules that take longest to import.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def run(photo: Path, out: Path, quality: str) -> tuple[float, float, dict[str, float], float]:
    """(wall s, processor s, seconds by stage, peak MB) of one run."""
    command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(out)]
    command += ["--face", "largest", "--json", "--quality", quality]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wall = time.perf_counter() - begin
    if done.returncode:
        raise SystemExit(f"exit status {done.returncode}: {done.stderr.strip()}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    answer = json.loads(done.stdout)
    return wall, used, answer["timings_s"], float(answer["peak_rss_mb"])


def imports(top: int = 12) -> list[str]:
    """The modules with the longest import times of their own, milliseconds."""
    command = [sys.executable, "-X", "importtime", "-c", "import service.pipeline, service.archive.pack"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = [line for line in done.stderr.splitlines() if line.count("|") == 2 and "self" not in line]
    rows = [line.split("|") for line in lines]
    times = sorted(((int(own.split(":")[-1]), name.strip()) for own, _, name in rows), reverse=True)
    total = sum(t for t, _ in times)
    return [f"all {total / 1000:.0f} ms"] + [f"{name} {t / 1000:.0f} ms" for t, name in times[:top]]


def spread(values: list[float]) -> str:
    """Minimum, median and maximum."""
    ordered = sorted(values)
    return f"{ordered[0]:.2f} / {ordered[len(ordered) // 2]:.2f} / {ordered[-1]:.2f}"


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photo", type=Path)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--quality", default="standard")
    arguments = parser.parse_args()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        target, count = Path(folder) / "out.zip", max(1, arguments.runs)
        runs = [run(arguments.photo, target, arguments.quality) for _ in range(count)]
    lines = [
        f"{len(runs)} runs, load average {load:.1f} before, on {os.cpu_count()} cores; lowest / median / highest",
        f"wall s       {spread([r[0] for r in runs])}",
        f"processor s  {spread([r[1] for r in runs])}",
        f"peak MB      {spread([r[3] for r in runs])}",
        "stages       " + ", ".join(f"{k} {v:.2f}" for k, v in runs[-1][2].items()),
        "imports      " + ", ".join(imports()),
    ]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
