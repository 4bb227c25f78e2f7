"""How well a stranger among the photos of a person is found: ``python -m benchmarks.strangers [--photos build/bench]``.

Takes the photos of ``benchmarks.shoot --views`` and, by ``--real DIR``, a folder of photos of different real people,
each also turned over, darker, smaller and blurred, which stand for further photos of them. Prints the distances of the
identity network between photos of one person and of two, and for each threshold how often one stranger among five is
found and how often a set without one is refused.
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
from service.arrays import UInt8
from service.face.finder import FaceFinder
from service.face.identity import Recogniser
from service.face.several import STRANGE, apart_from_most
from service.photo.gate import read_photo

Codes = dict[str, npt.NDArray[np.float64]]
SETS = 2000
"""Random sets of each kind."""
THRESHOLDS = (0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75)


def rendered(folder: Path) -> Codes:
    """(n, 128) descriptors of each rendered head's photos."""
    recogniser = Recogniser()
    return {
        name: np.stack([recogniser.embed(shot.photo.pixels, shot.face.landmarks) for shot in shots]).astype(np.float64)
        for name, shots in people(folder).items()
    }


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


def distances(codes: Codes) -> tuple[list[float], list[float]]:
    """Between photos of one person, and of two."""
    own = [float(np.linalg.norm(a - b)) for each in codes.values() for a, b in combinations(each, 2)]
    other = [
        float(np.linalg.norm(a - b)) for one, two in combinations(codes.values(), 2) for a in one for b in two
    ]
    return own, other


def rates(codes: Codes, threshold: float, rng: np.random.Generator) -> tuple[float, float]:
    """Share of sets of four and a stranger whose stranger alone is found, and of sets of five that are refused."""
    found = alarms = 0
    names = sorted(name for name, each in codes.items() if len(each) >= 5)
    for _ in range(SETS):
        name = names[rng.integers(len(names))]
        stranger = sorted(set(codes) - {name})[rng.integers(len(codes) - 1)]
        own = codes[name][rng.permutation(len(codes[name]))[:5]]
        mixed = [*own[:4], codes[stranger][rng.integers(len(codes[stranger]))]]
        found += apart_from_most(mixed, threshold) == [4]
        alarms += bool(apart_from_most(list(own), threshold))
    return found / SETS, alarms / SETS


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, default=Path("build/bench"))
    parser.add_argument("--real", type=Path)
    arguments = parser.parse_args()
    groups = {"rendered heads": rendered(arguments.photos / "views")}
    if arguments.real:
        groups["real people"] = real(arguments.real)
    for kind, codes in groups.items():
        own, other = distances(codes)
        print(f"{kind}: {len(codes)}; same person {np.percentile(own, [5, 50, 95, 99]).round(2)}, two people "
              f"{np.percentile(other, [1, 5, 50, 95]).round(2)} (percentiles 5, 50, 95, 99 and 1, 5, 50, 95)")
        for threshold in (*THRESHOLDS, STRANGE):
            found, alarms = rates(codes, threshold, np.random.default_rng(0))
            print(f"  threshold {threshold:.2f}: stranger found {found:.3f}, false alarms {alarms:.3f}")


if __name__ == "__main__":
    main()
