"""Import any linear head model from an ``.npz``: ``python -m models.head.import_npz IN.npz OUT.npz --unit-m 0.01``.

Wanted arrays: ``neutral`` (V, 3), ``identity`` (K, V, 3) per standard deviation, ``expression`` (E, V, 3) with
``expression_names``, ``quads`` and ``quads_uv`` (Q, 4) with -1 for triangles, ``uv`` (U, 2) in a 3:2 image, ``eyes``
(2, 3) eyeball centres, left first. +Y up, +Z forward.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np

from models.head.importing import Source, convert
from models.head.writing import save_head
from service.errors import ModelFault
from service.head.files import load_head

NEEDED = ("neutral", "identity", "expression", "expression_names", "quads", "quads_uv", "uv", "eyes")


def read_npz(path: Path, unit_m: float, name: str, licence: str) -> Source:
    """Read a model in the layout above.

    Raises:
        ModelFault: an array is missing.
    """
    with np.load(path, allow_pickle=False) as file:
        missing = [key for key in NEEDED if key not in file.files]
        if missing:
            raise ModelFault(f"{path} lacks {', '.join(missing)}")
        return Source(
            name=name,
            licence=licence,
            unit_m=unit_m,
            neutral=file["neutral"].astype(float),
            identity=file["identity"].astype(float),
            expression=file["expression"].astype(float),
            names=tuple(str(x) for x in file["expression_names"]),
            polygons=file["quads"].astype(np.int64),
            polygon_uv=file["quads_uv"].astype(np.int64),
            uv=file["uv"].astype(float),
            eyes=file["eyes"].astype(float),
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--unit-m", type=float, default=1.0, help="metres per unit of the file")
    parser.add_argument("--name", default="imported-head")
    parser.add_argument("--licence", required=True, help="licence of the imported data, for the manifest")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    source = read_npz(arguments.source, arguments.unit_m, arguments.name, arguments.licence)
    save_head(convert(source, load_head()), arguments.out)
    logging.getLogger(__name__).info("wrote %s", arguments.out)


if __name__ == "__main__":
    main()
