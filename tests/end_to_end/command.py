"""The command ``avatarme`` as a user starts it: a fresh process, real files, real pipes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).parents[2]

_MEASURED = """
import json, os, sys
report, sys.argv = sys.argv[1], ["avatarme", *sys.argv[2:]]
from service.cli.app import main
try:
    main()
finally:
    with open("/proc/self/status") as status:
        peak = next(line.split()[1] for line in status if line.startswith("VmHWM"))
    with open(report, "w") as stream:
        json.dump({"rss_mb": int(peak) / 1024, "cpu_s": sum(os.times()[:4])}, stream)
"""
"""The entry point, then a note of its peak memory (``ru_maxrss`` would count this test run's) and processor time."""


@dataclass(frozen=True)
class Ran:
    """One finished run: exit status, both outputs, wall and processor seconds (children too), peak memory in MiB."""

    status: int
    stdout: bytes
    stderr: str
    wall_s: float
    cpu_s: float
    rss_mb: float

    @property
    def json(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.stdout)
        return content

    def __str__(self) -> str:
        return f"{self.wall_s:.1f} s wall, {self.cpu_s:.1f} s of processor time, {self.rss_mb:.0f} MB"


def avatarme(*arguments: str | Path, stdin: bytes = b"") -> Ran:
    """Run the command; nothing is asserted."""
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-c", _MEASURED, str(report), *map(str, arguments)]
        begin = time.perf_counter()
        done = subprocess.run(command, cwd=ROOT, input=stdin, capture_output=True, timeout=1200)
        wall = time.perf_counter() - begin
        spent = json.loads(report.read_text())
    return Ran(done.returncode, done.stdout, done.stderr.decode(), wall, spent["cpu_s"], spent["rss_mb"])
