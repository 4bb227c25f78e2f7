"""This tree against another checkout: ``python -m benchmarks.against TREE PHOTO... [--quality NAME] [--rounds N]``.

Every photo is made by both, in turn, in processes of their own on the same machine, so that the ratios hold on a busy
one too. Printed are processor seconds (the least of the rounds), the archive's bytes, and what the second run of this
tree costs: ``--hair none``. For the parts of an avatar, TREE is a checkout of the commit before them:
``git worktree add TREE 1bbca25``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Cost:
    """Of one archive: processor seconds, bytes."""

    seconds: float
    size: int


def made(tree: Path, photo: Path, quality: str, more: list[str]) -> Cost:
    """Make an archive with the program of a checkout.

    Raises:
        SystemExit: it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "avatar.zip"
        command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(out), "--quality", quality, *more]
        child = subprocess.Popen(
            command, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise SystemExit(f"{tree}: {' '.join(command[1:])} ended with {child.returncode}")
        return Cost(used.ru_utime + used.ru_stime, out.stat().st_size)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tree", type=Path, help="the other checkout")
    parser.add_argument("photos", type=Path, nargs="+")
    parser.add_argument("--quality", default="draft")
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    runs: dict[str, tuple[Path, list[str]]] = {
        "before": (options.tree.resolve(), []), "now": (HERE, []), "--hair none": (HERE, ["--hair", "none"]),
    }  # fmt: skip
    print(f"{'photo':28s} {'run':12s} {'cpu s':>7s} {'ratio':>6s} {'MB':>7s} {'ratio':>6s}")
    for photo in options.photos:
        found: dict[str, list[Cost]] = {name: [] for name in runs}
        for _ in range(options.rounds):
            for name, (tree, more) in runs.items():
                found[name].append(made(tree, photo.resolve(), options.quality, more))
        first = found["before"]
        for name, costs in found.items():
            seconds, size = min(cost.seconds for cost in costs), costs[0].size
            ratios = seconds / min(cost.seconds for cost in first), size / first[0].size
            print(
                f"{photo.name:28s} {name:12s} {seconds:7.1f} {ratios[0]:6.2f} {size / 1e6:7.2f} {ratios[1]:6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
