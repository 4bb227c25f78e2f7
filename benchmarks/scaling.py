"""What more texels and more photos cost: ``python -m benchmarks.scaling PHOTO [--write docs/accuracy-time.md]``.

First a run of the command line for each size of the maps, from process start to written archive, each in a process of
its own. The texture is resampled at every size (level ``draft``), as super-resolution costs the same at all of them.
Then one process makes the same small avatar again and again, as the service's worker and ``avatarme batch`` do. Printed
are seconds, peak memory, the straight line through each, and how far it is off at most; memory of the second kind has
to stay where it is after the first photos.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from models.tables import tell
from service.bench.losses import FittedLine, line

MARK = ("<!-- scaling -->", "<!-- /scaling -->")
SETTLED = 3
"""Photos after which memory may not grow."""

_REPEATS = """
import json, sys, time
from pathlib import Path
from service.archive.pack import write_archive
from service.options import Options
from service.pipeline import make_avatar

data, target = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2])
width = int(sys.argv[4])
options = Options(quality="draft", size=(width, width * 2 // 3), face="largest")
for _ in range(int(sys.argv[3])):
    begin = time.perf_counter()
    write_archive(make_avatar(data, options), target)
    now = int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20
    print(json.dumps([time.perf_counter() - begin, now]), flush=True)
"""


def one_size(photo: Path, width: int, target: Path) -> tuple[float, float]:
    """Seconds of a run of the command line with maps so wide, and its peak memory in MiB.

    Raises:
        SystemExit: the run failed.
    """
    size = f"{width}x{width * 2 // 3}"
    command = [sys.executable, "-m", "service", "make", str(photo), "-o", str(target), "--face", "largest", "--json"]
    begin = time.perf_counter()
    done = subprocess.run([*command, "--quality", "draft", "--size", size], capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - begin
    if done.returncode:
        raise SystemExit(f"exit status {done.returncode}: {done.stderr.strip()}")
    return seconds, float(json.loads(done.stdout)["peak_rss_mb"])


def many_photos(photo: Path, count: int, width: int, target: Path) -> list[tuple[float, float]]:
    """Seconds of each of ``count`` avatars of one process, and its memory in MiB after each.

    Raises:
        SystemExit: the process failed.
    """
    command = [sys.executable, "-c", _REPEATS, str(photo), str(target), str(count), str(width)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"exit status {done.returncode}: {done.stderr.strip()}")
    return [(row[0], row[1]) for row in map(json.loads, done.stdout.splitlines())]


def in_words(found: FittedLine | None, unit: str) -> str:
    """A line as a sentence."""
    if found is None:
        return "Too few points for a line."
    return f"{found.start:.1f} s + {found.slope:.2f} s / {unit}, off by {100 * found.worst:.0f} % at most."


def tables(sizes: dict[int, tuple[float, float]], photos: list[tuple[float, float]], width: int) -> list[str]:
    """Markdown."""
    area = {one: one * one * 2 / 3 / 1e6 for one in sizes}
    lines = ["| maps | Mtexel | s | peak MiB |", "|---|---|---|---|"]
    lines += [f"| {one} x {one * 2 // 3} | {area[one]:.2f} | {s:.1f} | {mb:.0f} |" for one, (s, mb) in sizes.items()]
    lines += ["", in_words(line(list(area.values()), [s for s, _ in sizes.values()]), "Mtexel"), ""]
    lines += [f"| photos of {width} texels in one process | s in all | MiB after it |", "|---|---|---|"]
    total, sums = 0.0, []
    for index, (seconds, mb) in enumerate(photos):
        total += seconds
        sums.append(total)
        lines.append(f"| {index + 1} | {total:.1f} | {mb:.0f} |")
    grown = max(mb for _, mb in photos[SETTLED - 1 :]) - photos[SETTLED - 1][1]
    told = in_words(line(list(range(1, len(sums) + 1)), sums), "photo")
    return [*lines, "", f"{told} Memory grew by {grown:.0f} MiB after photo {SETTLED}."]


def main(
    photo: Annotated[Path, typer.Argument(help="A photo of a face.")],
    widths: Annotated[str, typer.Option(help="Of maps, multiples of 3, with commas between.")] = "768,1536,3072,6144",
    photos: Annotated[int, typer.Option(min=SETTLED, help="Avatars that one process makes.")] = 10,
    small: Annotated[int, typer.Option(help="Width of the maps of those.")] = 768,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "avatar.zip"
        sizes = {int(word): one_size(photo, int(word), target) for word in widths.split(",")}
        text = "\n".join(tables(sizes, many_photos(photo, photos, small, target), small))
    tell(text, MARK, write)


if __name__ == "__main__":
    typer.run(main)
