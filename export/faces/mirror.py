"""Derives which landmark of the face mesh mirrors which, and prints the table of ``service/face/detection.py``.

The mesh of a mirrored picture, mirrored back, is the mesh of the picture with left and right points exchanged, up to
the network's noise. Distances are summed over crops of the sample photo, shifted, scaled and turned a little, and the
assignment with the smallest sum is taken. It is refused unless it is its own inverse::

    python -m export.faces.mirror
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from export.faces.probes import sample_photo
from service.face.detection import LANDMARKS, MESH_SIZE
from service.face.finder import FaceFinder
from service.face.region import Region
from service.runtime.sessions import load_session


def derive(crops: int = 40) -> npt.NDArray[np.int64]:
    """(468,) mirror partner of each landmark; ValueError when the assignment is not its own inverse."""
    photo = sample_photo()
    session = load_session("face_mesh")
    landmarks = FaceFinder().find(photo)[0].landmarks
    centre, side = landmarks[:, :2].mean(0), 1.5 * float(np.ptp(landmarks[:, :2], axis=0).max())
    random = np.random.default_rng(0)
    cost = np.zeros((LANDMARKS, LANDMARKS))
    for _ in range(crops):
        x, y = centre + random.normal(0, 0.03, 2) * side
        crop = Region(x, y, side * random.uniform(0.85, 1.15), random.normal(0, 0.15)).cut(photo, MESH_SIZE)
        plain, mirrored = (
            session.run({"image": np.ascontiguousarray(c, np.float32)[None] / 255})[0].reshape(LANDMARKS, 3)
            for c in (crop, crop[:, ::-1])
        )
        back = mirrored * [-1, 1, 1] + [MESH_SIZE, 0, 0]
        cost += np.linalg.norm(plain[:, None] - back[None], axis=2)
    partner = linear_sum_assignment(cost)[1]
    if not np.array_equal(partner[partner], np.arange(LANDMARKS)):
        raise ValueError("the assignment is not its own inverse")
    return np.asarray(partner, np.int64)


def main() -> None:
    """Print the table, 20 numbers a line."""
    partner = derive()
    for start in range(0, LANDMARKS, 20):
        print("    " + ", ".join(str(v) for v in partner[start : start + 20]) + ",")  # noqa: T201


if __name__ == "__main__":
    main()
