"""Whether memory stays flat over many photos in one process: ``python -m benchmarks.flat_memory [PHOTO] [--count 50]``.

The same person again and again, each time from other bytes: the photo without some rows of its border. Printed is the
resident memory after each archive, and by how much it is larger at the end than after the fifth: more than ``MOST``
ends with 1.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from service import diagnosis
from service.archive.pack import write_archive
from service.options import Options
from service.pipeline import make_avatar

SETTLED = 5
"""Photos after which everything is loaded that is loaded once."""
MOST = 20.0
"""MiB."""


def resident_mb() -> float:
    """MiB of memory that this process has now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def main(
    photo: Annotated[Path, typer.Argument()] = diagnosis.SAMPLE,
    count: Annotated[int, typer.Option(min=SETTLED + 1)] = 50,
    quality: str = "draft",
) -> None:
    """Make them."""
    pixels = cv2.imread(str(photo), cv2.IMREAD_COLOR)
    if pixels is None:
        raise SystemExit(f"{photo} is no picture that OpenCV reads")
    options, seen = Options(quality=quality, face="largest"), list[float]()  # type: ignore[arg-type]
    for number in range(count):
        data = cv2.imencode(".png", np.ascontiguousarray(pixels[: len(pixels) - number % 25]))[1]
        write_archive(make_avatar(data.tobytes(), options), io.BytesIO())
        seen.append(resident_mb())
        typer.echo(f"{number + 1:4d} {seen[-1]:8.1f} MiB, at most {diagnosis.peak_rss_mb():8.1f}")
    grown = float(np.median(seen[-SETTLED:])) - seen[SETTLED - 1]
    typer.echo(f"{grown:+.1f} MiB from the fifth to the median of the last five")
    if grown > MOST:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
