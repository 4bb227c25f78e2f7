"""How well a stranger among the photos of a person is found: ``python -m benchmarks.strangers --real DIR``.

Takes the photos of ``benchmarks.shoot --views``, in which a head is seen from several sides in other lights (all of
these heads have one skin, so they are no strangers to each other), and of a folder ``--real`` with photos of different
real people, each also turned over, darker, smaller and blurred. Prints distances of the identity network, and for each
threshold how often one stranger among five is found and how often photos of one person are refused: a table, which
``--write docs/several-photos.md`` puts into the docs.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt

from benchmarks.fit import people
from models.tables import tell
from service.arrays import UInt8
from service.face.finder import FaceFinder
from service.face.identity import Recogniser
from service.face.several import SQUARELY_DEG, STRANGE, apart_from_most, turn_deg
from service.photo.gate import read_photo

Codes = dict[str, npt.NDArray[np.float64]]
MARK = ("<!-- strangers -->", "<!-- /strangers -->")
SETS = 2000
"""Random sets of each kind."""
THRESHOLDS = (0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75)


def rendered(folder: Path) -> Codes:
    """(n, 128) descriptors of each rendered head's photos."""
    recogniser = Recogniser()
    return {
        name: np.stack([
            recogniser.embed(shot.photo.pixels, shot.face.landmarks).astype(np.float64)
            for shot in shots if abs(turn_deg(shot.face)) < SQUARELY_DEG
        ])
        for name, shots in people(folder).items()
    }  # fmt: skip


def real(folder: Path) -> Codes:
    """The same of real people, one photo each in five guises."""
    finder, recogniser, found = FaceFinder(), Recogniser(), {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in {".jpg", ".png"}:
            continue
        photo = read_photo(path.read_bytes())
        codes = []
        for pixels in guises(photo.pixels):
            faces = finder.find(pixels)
            if len(faces) == 1:
                codes.append(recogniser.embed(pixels, faces[0].landmarks).astype(np.float64))
        if len(codes) >= 4:
            found[path.stem] = np.stack(codes)
    return found


def guises(pixels: UInt8) -> Iterator[UInt8]:
    """A photo as it is, turned over, darker, blurred and small."""
    import cv2

    yield pixels
    yield np.ascontiguousarray(pixels[:, ::-1])
    yield (255 * (pixels / 255) ** 1.8).astype(np.uint8)
    yield np.asarray(cv2.GaussianBlur(pixels, (0, 0), max(pixels.shape) / 500), np.uint8)
    yield np.asarray(cv2.resize(pixels, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA), np.uint8)


def distances(codes: Codes) -> list[float]:
    """Between photos of one person."""
    return [float(np.linalg.norm(a - b)) for each in codes.values() for a, b in combinations(each, 2)]


def between(codes: Codes) -> list[float]:
    """Between photos of two people."""
    return [float(np.linalg.norm(a - b)) for one, two in combinations(codes.values(), 2) for a in one for b in two]


def rates(own: Codes, strangers: Codes, threshold: float, rng: np.random.Generator) -> tuple[float, float]:
    """Share of sets of four and a stranger whose stranger alone is found, and of sets of four that are refused."""
    found = alarms = 0
    names, others = sorted(name for name, each in own.items() if len(each) >= 4), sorted(strangers)
    for _ in range(SETS):
        name = names[rng.integers(len(names))]
        beside = [one for one in others if one != name]
        other = beside[rng.integers(len(beside))]
        four = list(own[name][rng.permutation(len(own[name]))[:4]])
        place = int(rng.integers(5))
        mixed = [*four[:place], strangers[other][rng.integers(len(strangers[other]))], *four[place:]]
        found += apart_from_most(mixed, threshold) == [place]
        alarms += bool(apart_from_most(four, threshold))
    return found / SETS, alarms / SETS


def table(turned: Codes, strangers: Codes) -> list[str]:
    """Markdown: distances, then a row for each threshold."""
    same, apart = np.percentile(distances(turned), [5, 50, 95, 100]), np.percentile(between(strangers), [0, 1, 5, 50])
    rows = [
        f"{len(turned)} rendered heads, two photos of one: {_listed(same)} apart (percentiles 5, 50, 95, 100); "
        f"{len(strangers)} real people, photos of two: {_listed(apart)} (percentiles 0, 1, 5, 50).",
        "",
        "| threshold | stranger found, rendered | false alarms | stranger found, real | false alarms |",
        "|---" * 5 + "|",
    ]
    for threshold in (*THRESHOLDS, STRANGE):
        rng = np.random.default_rng(0)
        found = [f"{rate:.3f}" for own in (turned, strangers) for rate in rates(own, strangers, threshold, rng)]
        rows.append(f"| {threshold:.2f}{', the limit' * (threshold == STRANGE)} | " + " | ".join(found) + " |")
    return rows


def _listed(values: npt.NDArray[np.float64]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, default=Path("build/bench"))
    parser.add_argument("--real", type=Path, required=True, help="photos of different people")
    parser.add_argument("--write", type=Path, help="Markdown file to put the table into")
    arguments = parser.parse_args()
    rows = table(rendered(arguments.photos / "views"), real(arguments.real))
    tell("\n".join(rows), MARK, arguments.write)


if __name__ == "__main__":
    main()
