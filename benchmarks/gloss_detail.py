"""How strong the detail of specular albedo is: ``python -m benchmarks.gloss_detail PHOTO...``.

An avatar of each photo is made by ``service.pipeline.make_avatar``. Of four pieces of 37 mm, both cheeks and both sides
of the forehead: 100 x rms of the logarithm of the specular albedo by wavelength in mm, median of the four.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.lightstage.measures import gloss_bands
from models.lightstage.stage import Stage
from models.lightstage.statistics import FULL_PPM
from service.arrays import Float64
from service.colour import FULL_CODE
from service.options import Options
from service.pipeline import make_avatar

SIDE = 512


def patches(specular: Float64, stage: Stage) -> list[Float64]:
    """Four pieces, (512, 512) each, of a map (4096, 6144): cheeks and forehead, left and right."""
    windows = [stage.window(*stage.places()[place], SIDE) for place in ("cheek", "forehead")]
    return [
        np.ascontiguousarray(side[w.y : w.y + SIDE, w.x : w.x + SIDE])
        for w in windows
        for side in (specular, specular[:, ::-1])
    ]


def main(
    photos: Annotated[list[Path], typer.Argument(help="Photos.")],
    seed: Annotated[int, typer.Option(help="Of the detail that is drawn.")] = 1,
) -> None:
    """Print a table."""
    stage, head = Stage.open(), True
    for photo in photos:
        options = Options(maps=("specular_albedo",), face="largest", seed=seed)
        made = make_avatar(photo.read_bytes(), options).reflectance
        if made is None or made.specular_albedo is None:
            raise ValueError(f"{photo}: an avatar of this benchmark has to have the specular albedo")
        specular = made.specular_albedo.astype(np.float64) / FULL_CODE
        rows = [gloss_bands(piece, FULL_PPM) for piece in patches(specular, stage)]
        if head:
            typer.echo(f"| photo | {' | '.join(rows[0])} |\n|---{'|---' * len(rows[0])}|")
            head = False
        middle = [f"{np.median([row[name] for row in rows]):.2f}" for name in rows[0]]
        typer.echo(f"| {photo.stem} | {' | '.join(middle)} |")


if __name__ == "__main__":
    typer.run(main)
