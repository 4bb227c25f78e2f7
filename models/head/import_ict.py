"""Import ICT-FaceKit: ``python -m models.head.import_ict ICT.npz OUT.npz``.

Reads ``neutral, identity, expression, expression_names, quads, quads_uv, uv, landmarks68`` (centimetres), renames the
units to ARKit's, merges the pairs that ARKit does not split, and puts the UDIM tiles into one 3:2 image: the face
tile is a square at the left, the back of the head a smaller square at the upper right. Units that ARKit lacks keep an
``ict_`` prefix; the model has no ``tongueOut``.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.head.expression import ARKIT
from models.head.importing import Source, convert
from models.head.writing import save_head
from service.errors import ModelFault
from service.head.files import load_head

UNIT_M = 0.01
MERGED = ("browInnerUp", "cheekPuff")
EYE_DEPTH_CM = 1.0
"""The eyeballs' centres lie this far behind the mean of the lid landmarks."""
NEEDED = ("neutral", "identity", "expression", "expression_names", "quads", "quads_uv", "uv", "landmarks68")

Float = npt.NDArray[np.float64]


def arkit_units(names: list[str], offsets: Float) -> tuple[tuple[str, ...], Float]:
    """ARKit names and their offsets; ``_L``/``_R`` become Left/Right, split pairs are added up."""
    out: dict[str, Float] = {}
    for name, offset in zip(names, offsets, strict=True):
        stem, _, side = name.partition("_")
        if stem in MERGED and side:
            out[stem] = out.get(stem, np.zeros_like(offset)) + offset
            continue
        full = stem + {"L": "Left", "R": "Right", "": ""}.get(side, f"_{side}")
        out[full if full in ARKIT else f"ict_{name}"] = offset
    order = sorted(out, key=lambda n: (n.startswith("ict_"), n))
    return tuple(order), np.stack([out[n] for n in order])


def one_image(uv: Float, corners: npt.NDArray[np.int64]) -> Float:
    """Chart coordinates of UDIM tiles 0 and 1 moved into one 3:2 image.

    Raises:
        ModelFault: a polygon lies in another tile.
    """
    used = np.unique(corners[corners >= 0])
    tile = np.zeros(len(uv))
    tile[used] = np.floor(uv[used, 0])
    if not np.isin(tile[used], (0, 1)).all():
        raise ModelFault(f"chart tiles {sorted(set(tile[used].astype(int).tolist()))}: only 0 and 1 are known")
    u = np.where(tile == 0, uv[:, 0] * 2 / 3, 2 / 3 + (uv[:, 0] - 1) / 3)
    v = np.where(tile == 0, uv[:, 1], 0.5 + 0.5 * uv[:, 1])
    out = np.zeros_like(uv)
    out[used] = np.stack([u, v], 1)[used]
    return out


def read_ict(path: Path) -> Source:
    """Read the file.

    Raises:
        ModelFault: an array is missing or the chart is unknown.
    """
    with np.load(path, allow_pickle=False) as file:
        missing = [key for key in NEEDED if key not in file.files]
        if missing:
            raise ModelFault(f"{path} lacks {', '.join(missing)}")
        neutral = file["neutral"].astype(float)
        names, units = arkit_units([str(n) for n in file["expression_names"]], file["expression"].astype(float))
        marks = file["landmarks68"]
        lids = np.stack([neutral[marks[42:48]].mean(0), neutral[marks[36:42]].mean(0)])  # left (+X) first
        corners = file["quads_uv"].astype(np.int64)
        return Source(
            name="ict-facekit",
            licence="MIT",
            unit_m=UNIT_M,
            neutral=neutral,
            identity=file["identity"].astype(float),
            expression=units,
            names=names,
            polygons=file["quads"].astype(np.int64),
            polygon_uv=corners,
            uv=one_image(file["uv"].astype(float), corners),
            eyes=lids - [0.0, 0.0, EYE_DEPTH_CM],
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    save_head(convert(read_ict(arguments.source), load_head()), arguments.out)
    logging.getLogger(__name__).info("wrote %s", arguments.out)


if __name__ == "__main__":
    main()
