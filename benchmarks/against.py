"""This tree against another: ``python -m benchmarks.against [REF] [PHOTO...] [--quality NAME ...] [--rounds N]``.

``make speed`` runs it. Every photo is made by both, in turn, in processes of their own on the same machine, so that the
ratios hold on a busy one too: processor seconds above all, which do not count what others do. Printed are medians over
the rounds of seconds, processor seconds, peak memory and size of the archive, with the ratio to REF. Where this tree
takes ``MOST`` times the processor seconds or more, it ends with 1: the CHANGELOG has to say why.

REF is a commit or tag, or a folder with a checkout; without it the newest tag, or where there is none the commit that
this line of work began with.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
SAMPLE = HERE / "service" / "data" / "sample" / "astronaut.png"
FIRST = "06d5477"
"""What is compared with before there is a tag."""
MOST = 1.03


@dataclass(frozen=True)
class Cost:
    """Of one archive: seconds, processor seconds of all its processes, MiB of the largest of them, megabytes."""

    seconds: float
    processor: float
    peak: float
    size: float


def made(tree: Path, photo: Path, quality: str) -> Cost:
    """Make an archive with the program of a checkout.

    Raises:
        SystemExit: it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "avatar.zip"
        command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(out), "--quality", quality]
        begin = time.perf_counter()
        child = subprocess.Popen(
            command, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        _, status, used = os.wait4(child.pid, 0)
        seconds = time.perf_counter() - begin
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise SystemExit(f"{tree}: {' '.join(command[1:])} ended with {child.returncode}")
        return Cost(seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, out.stat().st_size / 1e6)


@contextmanager
def checkout(ref: str) -> Iterator[Path]:
    """A folder with REF: itself where it is one, else a work tree for the length of a ``with`` block."""
    if Path(ref).is_dir():
        yield Path(ref).resolve()
        return
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "worktree", "add", "--quiet", "--detach", str(tree), ref], cwd=HERE, check=True)
        try:
            yield tree
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(tree)], cwd=HERE, check=True)


def last_release() -> str:
    """The newest tag."""
    command = ["git", "describe", "--tags", "--abbrev=0"]
    found = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    return found.stdout.strip() or FIRST


def median(costs: list[Cost]) -> Cost:
    """Medians of each."""
    return Cost(*(statistics.median(values) for values in zip(*map(astuple, costs), strict=True)))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ref", nargs="?", default=last_release())
    parser.add_argument("photos", type=Path, nargs="*", default=[SAMPLE])
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    slower = []
    print(f"against {options.ref}, medians of {options.rounds}, in brackets the ratio to it")
    print(f"{'photo':28s} {'quality':10s} {'s':>14s} {'cpu s':>14s} {'peak MiB':>14s} {'MB':>14s}", flush=True)
    with checkout(options.ref) as other:
        for photo in options.photos:
            for quality in options.quality:
                both = [[made(tree, photo.resolve(), quality) for tree in (other, HERE)] for _ in range(options.rounds)]
                before, now = (median(list(costs)) for costs in zip(*both, strict=True))
                pairs = zip(astuple(now), astuple(before), strict=True)
                cells = "".join(f" {value:7.1f} ({value / old:4.2f})" for value, old in pairs)
                print(f"{photo.name:28s} {quality:10s}{cells}", flush=True)
                if now.processor > MOST * before.processor:
                    slower.append(f"{photo.name} at {quality}")
    if slower:
        raise SystemExit(f"more than {MOST} times the processor seconds: {', '.join(slower)}")


if __name__ == "__main__":
    main()
