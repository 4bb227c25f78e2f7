"""One face found in a photo, and the choice of the one to fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from service.arrays import Float64
from service.errors import FaceCutOff, FaceTooSmall, MultipleFaces, NoFace, UsageError

LANDMARK_COUNT = 468
"""MediaPipe face mesh topology."""


@dataclass(frozen=True)
class Face:
    """A detected face with its landmark mesh.

    Pixel coordinates have the centre of the top left pixel at (0.5, 0.5), x right, y down.

    Attributes:
        box: (4,) float64 x0, y0, x1, y1, detector box in photo pixels.
        score: detector probability in [0, 1].
        keypoints: (6, 2) float64 photo pixels: image-left eye, image-right eye, nose tip, mouth, image-left ear,
            image-right ear ("image-left" as seen when the face is upright).
        landmarks: (468, 3) float64: x, y in photo pixels, z in the same unit, growing away from the camera.
        presence: landmark network's face probability in [0, 1].
        warnings: stable codes found while locating the face.
    """

    box: Float64
    score: float
    keypoints: Float64
    landmarks: Float64
    presence: float
    warnings: tuple[str, ...] = field(default=())

    @property
    def area(self) -> float:
        """Area of the box in square pixels."""
        return float(np.prod(np.maximum(self.box[2:] - self.box[:2], 0)))


SMALLEST_FACE = 40.0
"""Face box in pixels below which no fit is attempted.

Measured by shrinking 17 real photos: root mean square shift of the landmarks over the inter-ocular distance, median
(largest), is 0.7 % (1.2 %) for a face of 80 pixels, 2.0 % (3.4 %) for 40, 2.7 % (5.0 %) for 30 and 3.3 % (5.5 %) for
24. Below 40 pixels this noise alone exceeds the landmark error of a good fit.
"""
GOOD_FACE = 80.0
"""Face box in pixels that the error messages recommend."""
RIVAL_AREA = 1 / 6
"""Box area over that of the largest face, from which another face makes the choice ambiguous."""
INSIDE_SHARE = 0.75
"""Smallest fraction of the landmarks that must lie inside the photo."""


def choose_face(faces: list[Face], which: int | Literal["largest"] | None, photo_size: tuple[int, int]) -> Face:
    """The one face to fit.

    Without a choice (None) the largest face has to be unambiguous: other faces are ignored when their box has less
    than a sixth of its area, so that people in the background of a portrait do not prevent a fit.

    Args:
        faces: as ``FaceFinder.find`` returns them, largest first.
        which: index into ``faces``, "largest", or None.
        photo_size: (width, height) in pixels.

    Raises:
        NoFace: there is none.
        MultipleFaces: several are large enough and none was chosen; ``extra["boxes"]`` lists all boxes by index.
        UsageError: the index does not exist.
        FaceTooSmall: the box is smaller than 40 pixels.
        FaceCutOff: less than three quarters of the face lie inside the photo.
    """
    if not faces:
        raise NoFace(f"no face was found; a photo should show one face, at least {GOOD_FACE:.0f} pixels wide")
    face = faces[_index(faces, which)]
    size = float(np.max(face.box[2:] - face.box[:2]))
    if size < SMALLEST_FACE:
        raise FaceTooSmall(
            f"the face is {size:.0f} pixels wide; {SMALLEST_FACE:.0f} are needed, "
            f"and {GOOD_FACE:.0f} or more for a good result",
            box=_box(face),
        )
    x, y = face.landmarks[:, 0], face.landmarks[:, 1]
    share = float(((x >= 0) & (x <= photo_size[0]) & (y >= 0) & (y <= photo_size[1])).mean())
    if share < INSIDE_SHARE:
        raise FaceCutOff(
            f"only {share:.0%} of the face lie inside the photo; {INSIDE_SHARE:.0%} are needed", box=_box(face)
        )
    return face


def _index(faces: list[Face], which: int | Literal["largest"] | None) -> int:
    if which is None:
        rivals = [f for f in faces if f.area >= RIVAL_AREA * faces[0].area]
        if len(rivals) > 1:
            raise MultipleFaces(
                f"the photo shows {len(rivals)} faces; choose one by its index (0 is the largest) or 'largest'",
                boxes=[_box(f) for f in faces],
            )
        return 0
    if which == "largest":
        return 0
    if isinstance(which, bool) or not isinstance(which, int) or not 0 <= which < len(faces):
        raise UsageError(f"no face {which!r}: the photo has {len(faces)}, counted from 0 by size", count=len(faces))
    return which


def _box(face: Face) -> list[float]:
    return [round(float(v), 1) for v in face.box]
