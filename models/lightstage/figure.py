"""Side by side: ``python -m models.lightstage.figure --data DIR -o docs/lightstage-skin.jpg``.

Of the real skins only the Lee Perry-Smith scan (Infinite-Realities, CC BY 3.0) may be shown.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer

from models.colour import srgb
from models.lightstage.references import SCAN_PPM, read
from models.lightstage.sheet import image, lit
from models.lightstage.stage import Stage
from models.lightstage.statistics import FULL_PPM
from service.archive.images import encode_jpeg

Bytes = npt.NDArray[np.uint8]

SCAN_WINDOWS = ((372, 330), (448, 150), (470, 470))
"""Corners in the scan's chart: cheek, forehead, chin."""
SIZE = 80
SEEDS = (1034, 1067, 1020)
SHOWN = 240


def _enlarged(piece: Bytes) -> Bytes:
    return np.asarray(cv2.resize(piece, (SHOWN, SHOWN), interpolation=cv2.INTER_CUBIC), np.uint8)


def _labelled(piece: Bytes, text: str) -> Bytes:
    strip = np.full((18, piece.shape[1], 3), 24, np.uint8)
    cv2.putText(strip, text, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (235, 235, 235), 1, cv2.LINE_AA)
    return np.vstack([strip, piece])


def draw(data: Path) -> Bytes:
    """(h, w, 3) uint8: the scan above synthetic skin at the scan's own scale, then synthetic skin at 1:1."""
    stage = Stage.open()
    colour = read(data / "lee_perry_smith" / "color.jpg")
    normal = read(data / "lee_perry_smith" / "normal.jpg")
    real = [[_enlarged(m[y : y + SIZE, x : x + SIZE]) for x, y in SCAN_WINDOWS] for m in (colour, normal)]
    rows = [
        _labelled(np.hstack([*real[0], *real[1]]), "Lee Perry-Smith scan (Infinite-Realities, CC BY 3.0), 2.65 px/mm")
    ]
    times = round(FULL_PPM / SCAN_PPM)
    full: list[list[Bytes]] = [[], []]
    for seed in SEEDS:
        skin = stage.skin(seed)
        pieces: list[list[Bytes]] = [[], []]
        for place in ("cheek", "forehead", "chin"):
            maps = skin.maps(stage.window(*stage.places()[place], SIZE * times))
            for k, values in enumerate((srgb(maps.diffuse_albedo), maps.specular_normal * 0.5 + 0.5)):
                small = cv2.resize(image(values), (SIZE, SIZE), interpolation=cv2.INTER_AREA)
                pieces[k].append(_enlarged(np.asarray(small, np.uint8)))
            if len(full[0]) < 6 and place != "forehead":
                middle = slice((SIZE * times - SHOWN) // 2, (SIZE * times + SHOWN) // 2)
                full[0].append(image(srgb(maps.diffuse_albedo))[middle, middle])
                full[1].append(image(lit(maps))[middle, middle])
        angle = skin.subject.tone.typology_angle_deg
        rows.append(
            _labelled(np.hstack([*pieces[0], *pieces[1]]), f"synthetic {seed} (ITA {angle:.0f}) at the same scale")
        )
    rows.append(_labelled(np.hstack(full[0]), "synthetic, 1:1, 14 px/mm: cheek and chin of each, albedo"))
    rows.append(_labelled(np.hstack(full[1]), "the same, lit from one side"))
    return np.vstack(rows)


def main(
    data: Annotated[Path, typer.Option(help="Folder of reference scans.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="JPEG to write.")],
) -> None:
    """Write the figure."""
    out.write_bytes(encode_jpeg(draw(data)))
    typer.echo(str(out))


if __name__ == "__main__":
    typer.run(main)
