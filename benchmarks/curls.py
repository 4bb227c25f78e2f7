"""Curls by how strands beside each other run: ``python -m benchmarks.curls SHARDS [--write docs/hair.md]``.

With ``--photos DIR --table CSV`` of photos instead: a table by eye, with the columns photo and curl, of people whose
hair hangs. Else drawn people whose grooms the reader was never taught (``python -m models.people --framing hair --count
224 --size 448 --out SHARDS``): how much the strands of each kind of curl agree, which is what ``service.hair.reading``
knows of curls beside its network, and how often the likeliest curl is right with and without it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.hair_reading import Eyes, likeliest
from models.people.shards import UNKNOWN
from models.tables import tell
from models.training.hair_data import CURL, LENGTH, crop_of_person, read_people
from service.hair.kinds import CURLS, KINDS, LENGTHS
from service.hair.reading import SIDE, HairNetwork, agreement, with_curls
from service.photo.gate import read_photo

MARK = ("<!-- curls -->", "<!-- /curls -->")
Told = tuple[str, float, str, str]
"""The true curl, the agreement, and the likeliest curl without it and with it."""


def measured(folder: Path) -> Iterator[Told]:
    """What is told of each person of shards whose hair hangs to the jaw or lower, and of whom enough is seen."""
    network, gathered = HairNetwork(), list(KINDS).index("gathered")
    for path in sorted(folder.glob("*.npz")):
        people = read_people(path)
        for i, kinds in enumerate(people["kinds"]):
            hangs = kinds[LENGTH] != UNKNOWN and kinds[LENGTH] >= LENGTHS.index("jaw")
            if not hangs or kinds[gathered] != 0 or kinds[CURL] == UNKNOWN:
                continue
            region, picture = crop_of_person(people, i, None)
            said = network(region.cut(picture, SIDE))
            agrees = agreement(picture, region, said.mask)
            if agrees is None:
                continue
            plain, both = said.kinds["curl"], with_curls(said.kinds, agrees)["curl"]
            yield CURLS[kinds[CURL]], agrees, likeliest(plain)[0], likeliest(both)[0]


def of_photos(folder: Path, table: Path) -> Iterator[Told]:
    """The same of the largest face of each photo of a table."""
    eyes = Eyes()
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        pixels = read_photo((folder / row["photo"]).read_bytes()).pixels
        read = eyes.read(pixels)
        if read is None:
            continue
        found, _ = read
        agrees = agreement(pixels, found.region, np.minimum(found.mask, found.known))
        if agrees is not None:
            plain = eyes.hair(found.region.cut(pixels, SIDE)).kinds["curl"]
            yield row["curl"], agrees, likeliest(plain)[0], likeliest(found.kinds["curl"])[0]


def main(
    shards: Annotated[Path | None, typer.Argument(help="Folder of drawn people.")] = None,
    write: Annotated[Path | None, typer.Option(help="Page to write the table into.")] = None,
    photos: Annotated[Path | None, typer.Option(help="Folder of photos.")] = None,
    table: Annotated[Path | None, typer.Option(help="CSV of their curls.")] = None,
) -> None:
    """Print a table by curl."""
    if photos is not None and table is not None:
        rows = list(of_photos(photos, table))
    elif shards is not None:
        rows = list(measured(shards))
    else:
        raise typer.BadParameter("either SHARDS, or --photos and --table")
    lines = ["| curl | people | agreement | network right | with the agreement |", "|---|---|---|---|---|"]
    for curl in (*CURLS, "all"):
        of = [row for row in rows if curl in (row[0], "all")]
        if of:
            agrees = np.array([row[1] for row in of])
            right = [100 * np.mean([row[k] == row[0] for row in of]) for k in (2, 3)]
            told = f"{agrees.mean():.2f} +- {agrees.std():.2f}"
            lines.append(f"| {curl} | {len(of)} | {told} | {right[0]:.0f} % | {right[1]:.0f} % |")
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
