"""Measures the population of face descriptors on folders of photos and writes ``face_identity_population.json``.

Only the mean of the descriptors and statistics over pairs are kept, no photo and no descriptor of a person::

    python -m export.faces.population FOLDER...

Faces that are nearer to an earlier one than 0.5 are taken for the same person and left out. The shipped file was made
from 39 people in the six demo photos of the npm package ``@vladmandic/face-api`` 1.7.15, the sample photos of public
face-reconstruction projects, and the sample photo of this repository.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from export.faces.probes import sample_photo
from export.faces.registry import MODELS, register
from service.face.finder import FaceFinder
from service.face.identity import Recogniser, centred_cosine, distance

SAME = 0.5
SUFFIXES = {".jpg", ".jpeg", ".png", ".webp"}


def photos(folders: list[Path]) -> list[npt.NDArray[np.uint8]]:
    """The sample photo, then all pictures of the folders by name."""
    found = [sample_photo()]
    for path in sorted(p for folder in folders for p in folder.iterdir() if p.suffix.lower() in SUFFIXES):
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is not None:
            found.append(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8))
    return found


def different_people(pictures: list[npt.NDArray[np.uint8]]) -> list[npt.NDArray[np.float32]]:
    """One descriptor for each person in the photos."""
    finder, recogniser = FaceFinder(), Recogniser()
    kept: list[npt.NDArray[np.float32]] = []
    for pixels in pictures:
        for face in finder.find(pixels):
            embedding = recogniser.embed(pixels, face.landmarks)
            if not face.warnings and all(distance(embedding, other) >= SAME for other in kept):
                kept.append(embedding)
    return kept


def measure(people: list[npt.NDArray[np.float32]]) -> dict[str, Any]:
    """Mean and impostor statistics; the mean that centres a pair leaves the pair out, or it would be biased."""
    stack = np.stack(people).astype(np.float64)
    total, distances, cosines = stack.sum(0), [], []
    for i, one in enumerate(stack):
        for other in stack[:i]:
            distances.append(distance(one, other))
            cosines.append(centred_cosine(one, other, (total - one - other) / (len(stack) - 2)))
    return {
        "faces": len(stack),
        "impostor": {
            "distance_mean": round(float(np.mean(distances)), 4),
            "distance_p05": round(float(np.percentile(distances, 5)), 4),
            "centred_cosine_mean": round(float(np.mean(cosines)), 4),
            "centred_cosine_p95": round(float(np.percentile(cosines, 95)), 4),
        },
        "mean": [round(float(v), 6) for v in stack.mean(0)],
    }


def main() -> None:
    """Measure the folders and write the file and its entry."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=MODELS)
    arguments = parser.parse_args()
    people = different_people(photos(arguments.folders))
    if len(people) < 10:
        raise SystemExit(f"only {len(people)} different people were found; at least 10 are needed")
    content = measure(people)
    path = arguments.out / "face_identity_population.json"
    path.write_text(json.dumps(content) + "\n")
    facts = {
        "licence": "CC0-1.0",
        "source": "statistics of face_identity over photos, python -m export.faces.population",
        "outputs": {"mean": [128]},
    }
    register("face_identity_population", path, facts)
    print(f"{content['faces']} people, impostors: {content['impostor']}")  # noqa: T201


if __name__ == "__main__":
    main()
