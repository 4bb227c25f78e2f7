"""Which of the faces in a photo is to be fitted, or why none can be."""

from __future__ import annotations

from typing import Literal

import numpy as np

from service.errors import FaceCutOff, FaceTooSmall, MultipleFaces, NoFace, UsageError
from service.face.face import Face

SMALLEST_FACE = 40.0
"""Face box in pixels below which no fit is attempted.

Landmarks of real photos that were shrunk differ from those of the full photo, in root mean square over the
inter-ocular distance, by 0.7 % for faces of 80 pixels, 2.0 % for 40, 2.7 % for 30, 3.3 % for 24 (median of 17 photos;
largest 1.2, 3.4, 5.0 and 5.5 %): below 40 the landmarks' own noise takes more than a good fit may be off.
"""
GOOD_FACE = 80.0
"""Face box in pixels that the messages recommend."""
RIVAL_AREA = 1 / 6
"""A second face counts when its box has at least this part of the largest one's area."""
INSIDE_SHARE = 0.75
"""Part of the mesh points that must lie inside the photo."""


def choose_face(faces: list[Face], which: int | Literal["largest"] | None, photo_size: tuple[int, int]) -> Face:
    """The one face to fit.

    Without a choice (None) there must be one face that matters: others count only when their box has at least a sixth
    of the largest one's area, so people in the background of a portrait do not stand in the way.

    Args:
        faces: as ``FaceFinder.find`` returns them, largest first.
        which: index into ``faces``, "largest", or None.
        photo_size: (width, height) in pixels.

    Raises:
        NoFace: there is none.
        MultipleFaces: several matter and none was chosen; ``extra["boxes"]`` has all boxes, in the order of the index.
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
