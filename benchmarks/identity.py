"""Is the avatar the person in the photo? ``python -m benchmarks.identity FOLDER... [--by-prefix] [--match GLOB]``.

Makes an avatar of each photo in the folders in this process, renders it from the front and compares descriptors of the
identity network: the render with its own photo, with photos of others, and photos among themselves. A distance or a
centred cosine means nothing alone, so all of these stand in one table, with the share of renders whose nearest photo
is of the right person. Each file shows a person of its own, unless ``--by-prefix`` says that names which agree up to
the first underscore show the same one, as the photos of ``benchmarks.shoot`` do.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program itself does

import numpy as np
import numpy.typing as npt

from service.errors import AvatarError
from service.face.choice import choose_face
from service.face.finder import FaceFinder
from service.face.fit.fit import fit_face
from service.face.fit.settings import FitSettings, Refine
from service.face.identity import Embedding, Recogniser, centred_cosine, distance, population
from service.face.reading.read import Readers, read_face
from service.geometry.chart import Chart
from service.head.files import load_head
from service.likeness import likeness
from service.options import Options
from service.photo.gate import read_photo
from service.texture.make import make_texture

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
Measure = Callable[[Embedding, Embedding], float]


@dataclass(frozen=True)
class Likeness:
    """Descriptors of one photo and of the avatar made from it: ``photo`` and ``render`` (128,) float32."""

    person: str
    photo: Embedding
    render: Embedding


class Recorder(Recogniser):
    """The identity network, keeping every descriptor that it gives."""

    def __init__(self) -> None:
        """Load the network."""
        super().__init__()
        self.given: list[Embedding] = []

    def embed(self, pixels: npt.NDArray[np.uint8], landmarks: npt.NDArray[np.floating]) -> Embedding:
        """As :meth:`Recogniser.embed`."""
        self.given.append(super().embed(pixels, landmarks))
        return self.given[-1]


class Maker:
    """Avatars in this process, by the stages of the pipeline up to the comparison."""

    def __init__(self, settings: FitSettings) -> None:
        """Load networks, head and chart once."""
        self._finder, self._readers, self._recorder = FaceFinder(), Readers(), Recorder()
        self._head, self._settings = load_head(), settings
        self._chart = Chart.build(self._head, *Options().texture_size)

    def __call__(self, path: Path, person: str) -> Likeness:
        """Make an avatar of the largest face in a photo; AvatarError as the pipeline raises it."""
        photo = read_photo(path.read_bytes())
        face = choose_face(self._finder.find(photo.pixels), "largest", photo.size)
        reading = read_face(photo.pixels, face.landmarks, self._readers)
        fit = fit_face(face, photo, self._head, self._settings, reading)
        texture = make_texture(photo, self._head, fit, self._chart, reading)
        self._recorder.given.clear()
        stated = likeness(photo, face, self._head, fit, texture.texture, self._recorder)
        theirs, ours = self._recorder.given
        if abs(stated.distance - distance(theirs, ours)) > 1e-6:
            raise RuntimeError("the comparison no longer looks at the photo first and at the render second")
        return Likeness(person, theirs, ours)


def pairs(samples: Sequence[Likeness], measure: Measure) -> dict[str, list[float]]:
    """A measure over all pairs, by what the two pictures are.

    Keys: "render, own photo"; "render, other photo of the person" (none where each person has one photo); "render,
    photo of another"; "photo, other photo of the person"; "photo, photo of another".
    """
    found: dict[str, list[float]] = {
        "render, own photo": [measure(s.render, s.photo) for s in samples],
        "render, other photo of the person": [],
        "render, photo of another": [],
        "photo, other photo of the person": [],
        "photo, photo of another": [],
    }
    for i, one in enumerate(samples):
        for j, other in enumerate(samples):
            whose = "other photo of the person" if one.person == other.person else "photo of another"
            if i != j:
                found[f"render, {whose}"].append(measure(one.render, other.photo))
            if i < j:
                found[f"photo, {whose}"].append(measure(one.photo, other.photo))
    return found


def rank_one(samples: Sequence[Likeness], own: bool) -> tuple[int, int]:
    """(renders whose nearest photo by distance is of their person, renders asked about).

    Args:
        samples: descriptors.
        own: whether the photo that the avatar was made from is among those to choose from; without it, only people with
            another photo are asked about.
    """
    right = asked = 0
    for i, one in enumerate(samples):
        gallery = [s for j, s in enumerate(samples) if own or i != j]
        if not any(s.person == one.person for s in gallery):
            continue
        nearest = min(gallery, key=lambda s: distance(one.render, s.photo))
        right += nearest.person == one.person
        asked += 1
    return right, asked


def report(samples: Sequence[Likeness]) -> list[str]:
    """The table and the retrieval, a line each."""
    distances, cosines = pairs(samples, distance), pairs(samples, centred_cosine)
    lines = [f"{'pair':36} {'n':>6}  {'distance':>20}  {'centred cosine':>20}"]
    lines.append(" " * 43 + f"{'median [5 %, 95 %]':>22}" * 2)
    for kind, values in distances.items():
        if values:
            lines.append(f"{kind:36} {len(values):6}  {spread(values):>20}  {spread(cosines[kind]):>20}")
    for own, gallery in ((True, "all photos"), (False, "all photos but its own")):
        right, asked = rank_one(samples, own)
        if asked:
            chance = len({s.person for s in samples})
            lines.append(f"nearest of {gallery} is the person: {right} of {asked} (among {chance} people)")
    shipped = population()
    told = ", ".join(f"{k} {v:.2f}" for k, v in shipped.impostor.items())
    lines.append(f"shipped impostor figures, of {shipped.faces} real people: {told}")
    return lines


def spread(values: Sequence[float]) -> str:
    """Median with the 5th and 95th percentile."""
    low, middle, high = np.percentile(values, [5, 50, 95])
    return f"{middle:.2f} [{low:.2f}, {high:.2f}]"


def photos_of(folders: Sequence[Path], match: str) -> list[Path]:
    """Image files of the folders in order of name; SystemExit when there are none."""
    found = [p for folder in folders for p in sorted(folder.glob(match)) if p.suffix.lower() in SUFFIXES]
    if not found:
        raise SystemExit(f"no photos ({', '.join(SUFFIXES)}) match {match!r} in {', '.join(map(str, folders))}")
    return found


def person_of(path: Path, by_prefix: bool) -> str:
    """Who is in a file; files of different folders never show the same person."""
    return f"{path.parent}/{path.stem.split('_')[0] if by_prefix else path.stem}"


def main() -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--by-prefix", action="store_true", help="names up to the first underscore name the person")
    parser.add_argument("--match", default="*", help="only files like this, for example 'ict*_0_soft*'")
    parser.add_argument("--refine", choices=get_args(Refine), default=FitSettings().refine)
    arguments = parser.parse_args()
    maker, samples, refused = Maker(FitSettings(refine=arguments.refine)), [], []
    for path in photos_of(arguments.folders, arguments.match):
        try:
            samples.append(maker(path, person_of(path, arguments.by_prefix)))
            one = samples[-1]
            numbers = f"{distance(one.photo, one.render):8.2f} {centred_cosine(one.photo, one.render):6.2f}"
            print(f"{path.name:40} {numbers}", flush=True)
        except AvatarError as refusal:
            refused.append(path.name)
            print(f"{path.name:40} refused: {refusal.message}", flush=True)
    if not samples:
        return 1
    print("\n".join(["", *report(samples), f"refused: {len(refused)} {' '.join(refused)}"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
