"""Makes the bank of styles: ``python -m models.hair.bank [--count 800] [-o service/data/hair/bank.npz]``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.hair.random_styles import sample_style
from service.arrays import Float32, UInt8
from service.face.region import Region
from service.hair.bank import CELLS, FILE, VIEWS, view_camera
from service.hair.groom import make_groom
from service.hair.kinds import KINDS, ends_m, kinds_of
from service.hair.reading import CELLS as PHOTO_CELLS
from service.hair.sight import Sight
from service.hair.style import NAMED, style_to_json
from service.head.files import load_head
from service.head.model import HeadModel

STRANDS = 700
"""Strands of a groom that is drawn for the bank."""
FIRST_SEED = 1_000_000
"""Seeds from here on are the bank's; training and tests take lower ones."""


def silhouettes(strands: Float32, sights: list[Sight]) -> UInt8:
    """(views, CELLS * CELLS / 8) uint8 bits of what each view shows of strands (N, P, 3)."""
    drawn = np.stack([sight.drawn(strands).mask for sight in sights])
    small = drawn.reshape(len(drawn), CELLS, drawn.shape[1] // CELLS, CELLS, -1).mean((2, 4))
    return np.packbits(small.reshape(len(drawn), -1) > 0.5, axis=1)


def view_sight(head: HeadModel, yaw_deg: float, pitch_deg: float) -> Sight:
    """The mean head in a view, without any hair."""
    camera = view_camera(yaw_deg, pitch_deg)
    return Sight.beside(head, head.mean, camera, Region(PHOTO_CELLS / 2, PHOTO_CELLS / 2, PHOTO_CELLS))


def main(
    count: Annotated[int, typer.Option(min=1, help="Styles beside the named ones.")] = 800,
    output: Annotated[Path, typer.Option("-o", "--output")] = FILE,
) -> None:
    """Make it."""
    head = load_head()
    sights = [view_sight(head, *view) for view in VIEWS]
    styles = [*NAMED.values(), *(sample_style(FIRST_SEED + k) for k in range(count))]
    masks, kinds, ends = [], [], []
    for seed, style in enumerate(styles):
        strands = make_groom(style, seed, STRANDS).strands
        masks.append(silhouettes(strands, sights))
        found = kinds_of(style, strands)
        ends.append(ends_m(strands) if len(strands) else 0.0)
        kinds.append([KINDS[name].index(found[name]) for name in KINDS])
    rows = np.frombuffer(json.dumps([style_to_json(style) for style in styles]).encode(), np.uint8)
    output.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        output, styles=rows, masks=np.stack(masks), kinds=np.array(kinds, np.uint8), ends=np.array(ends, np.float32)
    )
    typer.echo(f"{output}: {len(styles)} styles, {output.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    typer.run(main)
