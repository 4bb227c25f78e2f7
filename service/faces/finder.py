"""From pixels to faces: search, verification, landmarks, and the choice of one.

The search goes from coarse to fine. The whole photo is looked at first, then tiles of half, a quarter ... of its side,
until the smallest face that would still count has been looked for: the smallest usable one while none is known, else
one of a sixth of the largest face's area. A photo in which nothing is found with confidence is looked at in its three
turned copies too. Every candidate is looked at again in a level crop of its own before it counts.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from service.errors import FaceCutOff, FaceTooSmall, MultipleFaces, NoFace, UsageError
from service.faces import conditions
from service.faces.detector import Detection, Detector, merge
from service.faces.detector import INPUT_SIZE as DETECTOR_SIZE
from service.faces.face import Face
from service.faces.mesh import Mesh, MeshNetwork, locate
from service.faces.region import Region

Pixels = npt.NDArray[np.uint8]

SMALLEST_FACE = 40.0
"""Face box in pixels below which no fit is attempted."""
LOW_RESOLUTION = 80.0
"""Face box in pixels below which the fit carries the warning ``low-resolution``."""
SMALLEST_SOUGHT = 24.0
"""Faces are sought down to this box size, so that a small one is reported as small and not as absent."""
SMALLEST_IN_CROP = 20.0
"""Box size in the detector's 256-pixel input that it still finds reliably."""
CANDIDATE, CERTAIN = 0.4, 0.5
"""Scores: worth a second look; accepted."""
RIVAL_AREA = 1 / 6
"""A second face counts when its box has at least this part of the largest one's area."""
TURNS = (0, 1, 3, 2)
"""Quarter turns, counter-clockwise, in the order in which they are tried."""
INSIDE_SHARE = 0.75
"""Part of the mesh points that must lie inside the photo."""


class FaceFinder:
    """Finds faces and their landmark meshes. Not thread-safe; make one per worker."""

    def __init__(self, threads: int = 2) -> None:
        """Load the networks with ``threads`` compute threads each; ModelFault when a file is missing or changed."""
        self._detector = Detector(threads=threads)
        self._mesh = MeshNetwork(threads=threads)

    def find(self, pixels: Pixels) -> list[Face]:
        """All faces of an (H, W, 3) uint8 sRGB photo, largest box first; an empty list when there is none.

        Landmarks are in the frame of the photo as given, also for a face that lies on its side or stands on its head;
        such a face carries the warning ``turned-90``, ``turned-180`` or ``turned-270`` (degrees clockwise by which the
        head is turned).
        """
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
            raise ValueError(f"pixels must be (H, W, 3) uint8, not {pixels.shape} {pixels.dtype}")
        faces = [self._face(pixels, detection) for detection in self._search(pixels)]
        return sorted((f for f in faces if f is not None), key=lambda f: -_area(f.box))

    def _search(self, pixels: Pixels) -> list[Detection]:
        height, width = pixels.shape[:2]
        largest, tile = float(max(height, width)), float(max(height, width))
        known: list[Detection] = []
        while True:
            for turn in TURNS:
                known = merge(known + self._scan(pixels, tile, turn))
                if any(d.score >= CERTAIN for d in known):
                    break
            smallest = tile * SMALLEST_IN_CROP / DETECTOR_SIZE
            wanted = max([SMALLEST_SOUGHT, *(d.size * RIVAL_AREA**0.5 for d in known)])
            if smallest <= wanted or tile > 2 * largest:
                return known
            tile /= 2

    def _scan(self, pixels: Pixels, tile: float, turn: int) -> list[Detection]:
        """Detections verified in their own crops, in one pass of tiles of one size and quarter turn."""
        found: list[Detection] = []
        for region in tiles(pixels.shape[1], pixels.shape[0], tile, turn):
            found.extend(self._detector(pixels, region, CANDIDATE))
        verified = (self._verify(pixels, d) for d in merge(found))
        return [d for d in verified if d is not None]

    def _verify(self, pixels: Pixels, candidate: Detection) -> Detection | None:
        """Look again, level and close: the detection with the best score that overlaps the candidate, or None."""
        looks: list[Detection] = []
        for scale in (2.0, 3.0):
            seen = self._detector(pixels, candidate.region(scale), CERTAIN)
            looks.extend(d for d in seen if np.linalg.norm(d.centre - candidate.centre) < 0.5 * candidate.size)
        return merge(looks)[0] if looks else None

    def _face(self, pixels: Pixels, detection: Detection) -> Face | None:
        mesh = locate(self._mesh, pixels, detection)
        if mesh.presence < 0.5 and not mesh.consistent and detection.score < 0.75:
            return None
        return Face(
            box=detection.box,
            score=detection.score,
            keypoints=detection.keypoints,
            landmarks=mesh.landmarks,
            presence=mesh.presence,
            warnings=_warnings(pixels, detection, mesh),
        )


def _warnings(pixels: Pixels, detection: Detection, mesh: Mesh) -> tuple[str, ...]:
    found = []
    if not mesh.consistent:
        found.append("landmarks-inconsistent")
    if detection.size < LOW_RESOLUTION:
        found.append("low-resolution")
    quarter = round(np.degrees(detection.angle) / 90) % 4
    if quarter:
        found.append(f"turned-{quarter * 90}")
    return (*found, *conditions.warnings(pixels, mesh.landmarks))


def tiles(width: int, height: int, side: float, turn: int = 0) -> list[Region]:
    """Squares of ``side`` that cover a photo with a third of overlap; one that is as large as the photo is centred."""
    angle = -turn * np.pi / 2

    def centres(length: int) -> npt.NDArray[np.float64]:
        if length <= side:
            return np.array([length / 2])
        count = int(np.ceil((length - side) / (side * 2 / 3))) + 1
        return np.asarray(np.linspace(side / 2, length - side / 2, count))

    return [Region(float(x), float(y), side, angle) for y in centres(height) for x in centres(width)]


def _area(box: npt.NDArray[np.float64]) -> float:
    return float(np.prod(np.maximum(box[2:] - box[:2], 0)))


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
        raise NoFace("no face was found; a photo should show one face, upright, at least 80 pixels wide")
    face = faces[_index(faces, which)]
    size = float(np.max(face.box[2:] - face.box[:2]))
    if size < SMALLEST_FACE:
        raise FaceTooSmall(
            f"the face is {size:.0f} pixels wide; at least {SMALLEST_FACE:.0f} are needed, {LOW_RESOLUTION:.0f} or more "
            "for a good fit",
            box=_box(face),
        )
    x, y = face.landmarks[:, 0], face.landmarks[:, 1]
    share = float(((x >= 0) & (x <= photo_size[0]) & (y >= 0) & (y <= photo_size[1])).mean())
    if share < INSIDE_SHARE:
        raise FaceCutOff(
            f"only {share:.0%} of the face lie inside the photo; at least {INSIDE_SHARE:.0%} are needed", box=_box(face)
        )
    return face


def _index(faces: list[Face], which: int | Literal["largest"] | None) -> int:
    if which is None:
        rivals = [f for f in faces if _area(f.box) >= RIVAL_AREA * _area(faces[0].box)]
        if len(rivals) > 1:
            raise MultipleFaces(
                f"the photo shows {len(rivals)} faces; choose one with --face INDEX (0 is the largest) or --face largest",
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
