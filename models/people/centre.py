"""Centre the landmark embedding on real faces: ``python -m models.people.centre --photos DIR``.

To the landmark network synthetic people do not look quite like real ones, so an embedding that was calibrated on them
(``models.people.calibrate``) leaves errors which are the same on every photo. Here the head is fitted to the landmarks
of each face in a folder of photos, and the embedding moves over the surface by the median of what is left, mirror
images included. One number per landmark and axis is learnt, from turned faces none, and nothing of anybody's shape.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from models.head.embedding import EMBEDDING_FILE, save_both
from models.people.calibrate import LOWER_INNER, UPPER_INNER, Surface
from service.face.detection import MIRROR
from service.face.finder import Face, FaceFinder
from service.face.fit.fit import FitSettings
from service.face.fit.fit_face import prior_for
from service.face.fit.landmark_fit import LandmarkModel, Observed, fit_landmarks
from service.face.fit.solver import project_points
from service.face.reading.openings import Landmarker, Scores
from service.head.files import DEFAULT_HEAD, load_head
from service.head.model import HeadModel
from service.photo.gate import read_photo
from service.photo.photo import Photo

Float = npt.NDArray[np.float64]

MOST_YAW_DEG, MOST_PITCH_DEG = 20.0, 18.0
"""Turned faces beyond these are left out."""
MOST_RMS_M = 0.002
"""Landmark error on the face from which it is taken for misread."""
FEWEST_FACES = 20
"""Fewest faces whose median is taken: its error is a quarter of their scatter."""
ROUNDS = 2
"""How often the photos are fitted: shapes follow the embedding that moved. A third round changed nothing."""
Place = tuple[int, Float]
"""A triangle and the barycentric coordinates in it."""

log = logging.getLogger(__name__)


def residual(head: HeadModel, photo: Photo, face: Face, scores: Scores | None) -> Float | None:
    """(468, 2) metres along the head's x and y from its landmarks to those of a photo; None where it does not fit."""
    settings = FitSettings(refine="landmarks")
    model, middle = LandmarkModel(head, settings.identity_components), 0.5 * np.array(photo.size, np.float64)
    observed, prior = Observed.of(face.landmarks, middle), prior_for(photo, model, settings, scores)
    found = fit_landmarks(model, [observed], [prior], settings)[0]
    yaw, pitch, _ = found.state.camera(*photo.size).yaw_pitch_roll_deg()
    off = face.landmarks[:, :2] - middle - project_points(found.state, found.basis.points(found.state.coefficients)).uv
    off = off / found.state.scale
    rms = float(np.sqrt((off**2).sum(1).mean()))
    if abs(yaw) > MOST_YAW_DEG or abs(pitch) > MOST_PITCH_DEG or not rms < MOST_RMS_M:
        return None
    return np.asarray(off @ found.state.rotation[:2, :2])


def median_residual(residuals: list[Float]) -> Float:
    """(468, 2) the median over faces and their mirror images.

    Raises:
        ValueError: there are fewer than ``FEWEST_FACES``.
    """
    if len(residuals) < FEWEST_FACES:
        raise ValueError(f"{len(residuals)} faces seen from the front; at least {FEWEST_FACES} are needed")
    faces = np.stack(residuals)
    return np.asarray(np.median(np.concatenate([faces, faces[:, MIRROR] * [-1.0, 1.0]]), axis=0))


def moved(head: HeadModel, shift: Float) -> HeadModel:
    """The head with its landmarks moved over the surface by (468, 2) metres along x and y; each lip keeps its own."""
    surface, upper, lower = Surface(head), Surface(head, "upper"), Surface(head, "lower")
    lips = {**dict.fromkeys(UPPER_INNER, upper), **dict.fromkeys(LOWER_INNER, lower)}

    def there(triangles: npt.NDArray[np.int32], weights: npt.NDArray[np.float32], landmarks: list[int]) -> list[Place]:
        corners = head.mean[head.triangles[triangles]].astype(np.float64)
        points = (corners * weights[..., None]).sum(1)
        points[:, :2] += shift[landmarks]
        return [lips.get(k, surface).project(point) for k, point in zip(landmarks, points, strict=True)]

    every, outline = list(range(len(shift))), [int(k) for k in head.contour_landmarks]
    fixed = there(head.landmark_triangle, head.landmark_barycentric, every)
    slide = [there(*yaw, outline) for yaw in zip(head.contour_triangle, head.contour_barycentric, strict=True)]
    return replace(
        head,
        landmark_triangle=np.array([place[0] for place in fixed], np.int32),
        landmark_barycentric=np.array([place[1] for place in fixed], np.float32),
        contour_triangle=np.array([[place[0] for place in yaw] for yaw in slide], np.int32).reshape(-1, len(outline)),
        contour_barycentric=np.array([[place[1] for place in yaw] for yaw in slide], np.float32),
    )


def faces_in(folder: Path) -> Iterator[tuple[Photo, Face, Scores | None]]:
    """Every face in the photos of a folder.

    Raises:
        SystemExit: it holds no photo.
    """
    finder, network = FaceFinder(), Landmarker()
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".webp"))
    if not paths:
        raise SystemExit(f"{folder}: no photos")
    for path in paths:
        photo = read_photo(path.read_bytes())
        for face in finder.find(photo.pixels):
            yield photo, face, network(photo.pixels, face.landmarks)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, required=True, help="folder of photos, each with a face or several")
    parser.add_argument("--head", type=Path, default=DEFAULT_HEAD)
    parser.add_argument("--out", type=Path, default=EMBEDDING_FILE, help="embedding file that the builder takes over")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    head, faces = load_head(arguments.head), list(faces_in(arguments.photos))
    for _ in range(ROUNDS):
        found = [residual(head, *one) for one in faces]
        shift = median_residual([one for one in found if one is not None])
        count, size = sum(one is not None for one in found), float(np.sqrt((shift**2).sum(1).mean()))
        log.info("%d of %d faces, rms of the median %.2f mm", count, len(faces), 1e3 * size)
        head = moved(head, shift)
    save_both(head, arguments.head, arguments.out)


if __name__ == "__main__":
    main()
