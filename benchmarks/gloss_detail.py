"""How strong the detail of specular albedo is: ``python -m benchmarks.gloss_detail ARCHIVE...``.

Archives are those of ``avatarme make`` at ``standard`` or above. Of four pieces of 37 mm, both cheeks and both sides
of the forehead: 100 x rms of the logarithm of the specular albedo by wavelength in mm; the median of the four.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from zipfile import BadZipFile, ZipFile

import numpy as np
import typer

from models.lightstage.measures import gloss_bands
from models.lightstage.stage import Stage
from models.lightstage.statistics import FULL_PPM
from service.archive.reading import unpack_map
from service.arrays import Float64
from service.errors import BadArchive
from service.levels import FULL_SIZE

SIDE = 512


def patches(specular: Float64, stage: Stage) -> list[Float64]:
    """Four pieces, (512, 512) each, of a map (4096, 6144): cheeks and forehead, left and right."""
    windows = [stage.window(*stage.places()[place], SIDE) for place in ("cheek", "forehead")]
    return [
        np.ascontiguousarray(side[w.y : w.y + SIDE, w.x : w.x + SIDE])
        for w in windows
        for side in (specular, specular[:, ::-1])
    ]


def main(archives: Annotated[list[Path], typer.Argument(help="Archives with a full-size specular albedo.")]) -> None:
    """Print a table.

    Raises:
        BadArchive: an archive has no such map.
    """
    stage, head = Stage.open(), True
    for path in archives:
        try:
            png = ZipFile(path).read("maps/specular_albedo.png")
        except (OSError, BadZipFile, KeyError) as error:
            raise BadArchive(f"{path}: no archive with maps/specular_albedo.png: {error}") from error
        specular = unpack_map(png, "specular_albedo")[..., 0].astype(np.float64) / 255.0
        if specular.shape[1] != FULL_SIZE[0]:
            raise BadArchive(f"{path}: the map is {specular.shape[1]} texels wide; it has to be {FULL_SIZE[0]}")
        rows = [gloss_bands(piece, FULL_PPM) for piece in patches(specular, stage)]
        if head:
            typer.echo(f"| archive | {' | '.join(rows[0])} |\n|---{'|---' * len(rows[0])}|")
            head = False
        middle = [f"{np.median([row[name] for row in rows]):.2f}" for name in rows[0]]
        typer.echo(f"| {path.stem} | {' | '.join(middle)} |")


if __name__ == "__main__":
    typer.run(main)
