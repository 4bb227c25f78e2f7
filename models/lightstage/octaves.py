"""Strength of colour and of relief by octave on synthetic skin: ``python -m models.lightstage.octaves``.

``service.reflectance.relief.normal_inputs`` weighs what a photo's shade tells of the normals by these.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.lightstage.stage import Stage
from models.tables import tell
from service.colour import LUMA
from service.texture.photo_sampling import split_octaves

COUNT = 5
TEXEL_MM = 1 / 14
"""Of the full chart on the face, about."""
MARK = ("<!-- octaves -->", "<!-- /octaves -->")


def strengths(stage: Stage, seed: int, size: int = 512) -> np.ndarray:
    """(places, ``COUNT``, 2) standard deviations on cheek and forehead, finest octave first.

    The first is that of the natural logarithm of the albedo's luma, the second that of one component of the specular
    normal.
    """
    skin, found = stage.skin(seed), []
    for place in ("cheek", "forehead"):
        maps = skin.maps(stage.window(*stage.places()[place], size))
        colour = maps.diffuse_albedo.permute(1, 2, 0).numpy() @ LUMA
        bands, _ = split_octaves(np.log(np.maximum(colour, 1e-3)).astype(np.float32), COUNT)
        bent, _ = split_octaves(np.ascontiguousarray(maps.specular_normal.permute(1, 2, 0).numpy()[..., :2]), COUNT)
        found.append([(float(a.std()), float(np.sqrt(b.var((0, 1)).mean()))) for a, b in zip(bands, bent, strict=True)])
    return np.array(found)


def main(
    subjects: Annotated[int, typer.Option(help="How many.")] = 4,
    first: Annotated[int, typer.Option(help="Seed of the first.")] = 2000,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    stage = Stage.open()
    every = np.concatenate([strengths(stage, first + index) for index in range(subjects)])
    lines = ["| periods, texels of 6144 | log albedo | normal, x or y |", "|---|---|---|"]
    for index, (colour, bent) in enumerate(np.sqrt(np.square(every).mean(0))):
        lines.append(f"| {2 ** (index + 1)} to {2 ** (index + 2)} | {colour:.4f} | {bent:.4f} |")
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
