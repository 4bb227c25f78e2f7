"""Synthetic people on disk: ``python -m models.people --count N --start S --size 256 --out DIR``.

Shards that are there already are kept, so an interrupted run goes on where it stopped. ``--sheet FILE`` draws a sheet
of 48, ``--statistics N`` measures N portraits, ``--skins`` only draws the skins that all portraits share.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

SHEET = (8, 6)


def sheet(path: Path, start: int, size: int) -> None:
    """A JPEG of 48 portraits, eight in a row."""
    import cv2
    import numpy as np

    from models.people.make import portrait

    across, down = SHEET
    images = [
        cv2.resize(portrait(start + k).image, (size, size), interpolation=cv2.INTER_AREA) for k in range(across * down)
    ]
    rows = [np.hstack(images[k * across : (k + 1) * across]) for k in range(down)]
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


def make(
    start: int, count: int, size: int, out: str, jobs: int, database: str, framing: str, meshes: list[str]
) -> bool:
    """Draw all shards that are missing; whether all are there then."""
    from models.drawing import draw_all
    from models.people.shards import orders
    from models.people.skins import prepare

    if not database:
        prepare()
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of Mesa's software renderer, in the processes that draw
    return draw_all(orders(start, count, size, framing, meshes), out, jobs=jobs, database=database)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m models.people", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=64, help="portraits")
    parser.add_argument("--start", type=int, default=0, help="first seed")
    parser.add_argument("--size", type=int, default=256, help="side, pixels")
    parser.add_argument("--out", help="folder or s3:// address of the shards")
    parser.add_argument("--database", default="", help="have them drawn by workers of this Postgres: models/drawing.py")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--sheet", type=Path, help="draw a sheet of 48 portraits to this JPEG file")
    parser.add_argument("--statistics", type=int, metavar="N", help="measure N portraits and print a table")
    parser.add_argument("--framing", choices=("face", "hair"), default="face", help="the face, or all of the hair")
    parser.add_argument("--meshes", default="", help="hair meshes of the wardrobe, comma-separated, in place of grooms")
    parser.add_argument("--skins", action="store_true", help="only draw the skins")
    chosen = parser.parse_args()
    if chosen.count < 1 or chosen.start < 0 or chosen.size < 16 or chosen.jobs < 1:
        parser.error("--count, --jobs from 1, --start from 0, --size from 16")
    if chosen.skins:
        from models.people.skins import prepare

        prepare()
    if chosen.sheet:
        sheet(chosen.sheet, chosen.start, 192)
    if chosen.statistics:
        from models.people.statistics import statistics

        sys.stdout.write(statistics(chosen.start, chosen.statistics, chosen.size))
    if chosen.out:
        meshes, where = [name for name in chosen.meshes.split(",") if name], (chosen.out, chosen.jobs, chosen.database)
        if not make(chosen.start, chosen.count, chosen.size, *where, chosen.framing, meshes):
            raise SystemExit(1)
    if not (chosen.skins or chosen.sheet or chosen.statistics or chosen.out):
        parser.error("say what to do: --out, --sheet, --statistics or --skins")


if __name__ == "__main__":
    main()
