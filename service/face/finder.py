"""Find the faces of a photo, by multi-scale search and verification of every candidate, and choose the one to fit.

The search goes from coarse to fine: the whole photo with a margin, the whole photo, then overlapping tiles of half its
side, a quarter and so on. It ends at the smallest face worth reporting or, once a face is known, at faces of a sixth of
the largest one's area. If nothing is found, the photo is also searched turned by 90, 180 and 270 degrees. Each
candidate is verified in separate level crops, in which detector and landmark mesh have to agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from service.arrays import Float64, UInt8
from service.colour import luma, srgb_to_linear
from service.errors import FaceCutOff, FaceTooSmall, MultipleFaces, NoFace, UsageError
from service.face.detection import (
    DETECTOR_SIZE,
    REGION_SCALE,
    STRONG,
    Detection,
    Detector,
    Mesh,
    MeshNetwork,
    locate,
    merge,
    overlap,
)
from service.face.features.rims import RIMS, inside_rim
from service.face.region import Region
from service.words import WarningCode

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
        warnings: found while locating the face.
    """

    box: Float64
    score: float
    keypoints: Float64
    landmarks: Float64
    presence: float
    warnings: tuple[WarningCode, ...] = field(default=())

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


SMALLEST_IN_CROP = 14.0
"""Smallest box found reliably in the detector's 256-pixel input, pixels (measured: 98 of 100 at 12 pixels)."""
HINT, CERTAIN = 0.4, 0.5
"""Detector scores from which a box is a candidate, and from which its verification succeeds."""
UNCERTAIN = 10.0
"""Presence logit below which the face gets the warning ``landmarks-uncertain``; typical from 75 degrees of yaw."""
ABSENT = 1.0
"""Presence logit below which there is no face; full profiles are below, as their landmarks would be guesses.

The reader may still see one there (``service.face.profile``)."""
CONSISTENT = 0.12
"""Largest mean distance between mesh and detector keypoints, over the box size, that counts as agreement.

Measured: 0.01 to 0.04 on portraits, over 0.2 for a mesh beside the face."""
DOUBTED_PASSES, MOST_DOUBTED = 3, 3
"""Coarsest passes in which ``doubted`` looks, and how many boxes it gives at most."""


class FaceFinder:
    """Finds faces and their landmark meshes. Holds two networks (0.1 s to load); use one per thread."""

    def __init__(self) -> None:
        """Load the networks; ModelFault when a file is missing or changed."""
        self._detector = Detector()
        self._mesh = MeshNetwork()

    def find(self, pixels: UInt8) -> list[Face]:
        """All faces of an (H, W, 3) uint8 sRGB photo, largest box first; an empty list when there is none.

        Landmarks are in the frame of the photo as given, also for a face that lies on its side or stands on its head.

        Raises:
            ValueError: pixels have another shape or type.
        """
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8 or not pixels.size:
            raise ValueError(f"pixels must be (H, W, 3) uint8 and not empty, not {pixels.shape} {pixels.dtype}")
        return sorted(self._search(pixels), key=lambda face: -face.area)

    def doubted(self, pixels: UInt8) -> list[Detection]:
        """What the detector takes for upright faces, best first, whatever the landmark network says.

        Of use where ``find`` has nothing: the landmark network sees few profiles (``service.face.profile``).
        """
        height, width = pixels.shape[:2]
        passes = list(tile_sides(width, height))[:DOUBTED_PASSES]
        regions = (region for side in passes for region in photo_tiles(width, height, side))
        return merge([one for region in regions for one in self._detector(pixels, region, CERTAIN)])[:MOST_DOUBTED]

    def _search(self, pixels: UInt8) -> list[Face]:
        height, width = pixels.shape[:2]
        faces: list[Face] = []
        for side in tile_sides(width, height):
            largest = max((float(np.sqrt(face.area)) for face in faces), default=0.0)
            if largest * RIVAL_AREA**0.5 > 2 * side * SMALLEST_IN_CROP / DETECTOR_SIZE:
                break  # the pass before, with tiles of twice the side, found every face large enough to count
            faces = self._scan(pixels, side, 0.0, faces)
        for turn in (0.5, 1.5, 1.0):
            if not faces:
                for side in list(tile_sides(width, height))[1:3]:
                    faces = self._scan(pixels, side, turn * np.pi, faces)
        return faces

    def _scan(self, pixels: UInt8, side: float, angle: float, faces: list[Face]) -> list[Face]:
        """One pass over tiles; returns ``faces`` with the new ones that do not overlap them."""
        height, width = pixels.shape[:2]
        regions = photo_tiles(width, height, side, angle)
        found = [one for region in regions for one in self._detector(pixels, region, HINT)]
        # Most candidates of one pass that are verified, best first.
        for candidate in merge(found)[:12]:
            if _found_before(candidate.box, faces):
                continue
            face = self._verify(pixels, candidate)
            if face is not None and not _found_before(face.box, faces):
                faces = [*faces, face]
        return faces

    def _verify(self, pixels: UInt8, candidate: Detection) -> Face | None:
        """Run detector and landmark network in turn until they agree; None where there is no face.

        The later rounds use the roll and the position of the mesh, which corrects a box that was half off the face or
        that came from a turned face.
        """
        seen = self._detect_near(pixels, candidate.region(1.0), candidate)
        best: tuple[float, Detection, Mesh] | None = None
        # Most rounds of detector and landmarks in the verification of a candidate.
        for _ in range(3):
            if seen is None:
                break
            mesh = locate(self._mesh, pixels, seen)
            if mesh.logit < ABSENT:
                break
            level = mesh.region
            again = self._detect_near(pixels, Region(level.x, level.y, level.side / REGION_SCALE, level.angle), seen)
            gap = mesh.disagreement(again) if again else 1.0
            if again and (best is None or gap < best[0]):
                best = gap, again, mesh
            if gap <= CONSISTENT:
                break
            seen = again
        if best is None:
            return None
        _, detection, found = best
        # A clear mesh, or a weak one with a strong detection.
        if not (found.logit >= UNCERTAIN or (found.logit >= ABSENT and detection.score >= STRONG)):
            return None
        return _face(pixels, *best)

    def _detect_near(self, pixels: UInt8, region: Region, near: Detection) -> Detection | None:
        """Average of the detections in two crops around ``region``, the expected box; None where none is near."""
        found: list[Detection] = []
        for scale in (2.0, 3.0):
            crop = Region(region.x, region.y, region.side * scale, region.angle)
            close = [d for d in self._detector(pixels, crop, CERTAIN) if _close(d, near)]
            found.extend(close[:1])
        return merge(found)[0] if found else None


def tile_sides(width: int, height: int) -> Iterator[float]:
    """Tile sides in pixels, coarse to fine: 1.5 and 1 times the longer side, then halved down to the finest needed.

    >>> [round(side) for side in tile_sides(1600, 1200)]
    [2400, 1600, 800, 439]
    """
    longest = float(max(width, height))
    # Approximate limit of tiles in the finest pass; larger photos get larger tiles, which bounds the time.
    budget = (2.25 * width * height / 150) ** 0.5  # tiles lie two thirds of a side apart
    # Smallest face box searched for, pixels; below ``SMALLEST_FACE``, so that a small face is reported as such.
    finest = max(24.0 * DETECTOR_SIZE / SMALLEST_IN_CROP, budget)
    yield 1.5 * longest
    side = longest
    while side > finest:
        yield side
        side /= 2
    yield min(finest, longest)


def photo_tiles(width: int, height: int, side: float, angle: float = 0.0) -> list[Region]:
    """Squares of ``side`` that cover a photo and overlap by a third; a square as large as the photo is centred."""

    def centres(length: int) -> Float64:
        if length <= side:
            return np.array([length / 2])
        count = int(np.ceil((length - side) / (side * 2 / 3))) + 1
        return np.asarray(np.linspace(side / 2, length - side / 2, count))

    return [Region(float(x), float(y), side, angle) for y in centres(height) for x in centres(width)]


def _close(one: Detection, other: Detection) -> bool:
    return bool(np.hypot(*(one.centre - other.centre)) < 0.5 * other.size and 0.5 < one.size / other.size < 2)


def _found_before(box: Float64, faces: list[Face]) -> bool:
    """Whether a box is one of the faces: half of the smaller one lies in the other, or IoU is above 0.3."""
    for face in faces:
        shared = np.prod(np.maximum(np.minimum(box[2:], face.box[2:]) - np.maximum(box[:2], face.box[:2]), 0))
        smaller = min(float(np.prod(box[2:] - box[:2])), face.area)
        if shared > 0.5 * smaller or overlap(box, face.box[None])[0] > 0.3:
            return True
    return False


def _face(pixels: UInt8, gap: float, detection: Detection, mesh: Mesh) -> Face:
    warnings: list[WarningCode] = []
    if gap > CONSISTENT:
        warnings.append("landmarks-inconsistent")
    if mesh.logit < UNCERTAIN:
        warnings.append("landmarks-uncertain")
    # Face box in pixels below which the fit is less certain (warning ``low-resolution``).
    if detection.size < 80.0:
        warnings.append("low-resolution")
    turned: tuple[WarningCode, ...] = ("turned-90", "turned-180", "turned-270")
    quarter = round(np.degrees(detection.angle) / 90) % 4
    if quarter:
        warnings.append(turned[quarter - 1])
    return Face(
        box=detection.box,
        score=detection.score,
        keypoints=detection.keypoints,
        landmarks=mesh.landmarks,
        presence=mesh.presence,
        warnings=(*warnings, *photo_warnings(pixels, mesh.landmarks)),
    )


CHEEKS = ((116, 117, 118, 101, 205, 187, 147, 123), (345, 346, 347, 330, 425, 411, 376, 352))
"""Landmarks around the cheek below the image-left and the image-right eye, in order."""
OVAL = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
"""Landmarks around the face, in order."""

COVERED_LEVEL, COVERED_CONTRAST = 0.35, 0.4
"""An eye counts as covered if its 75th percentile of luminance is below the first factor times the cheek's median, and
its interquartile range is at most the second factor times its mean.

The second ratio is 0.55 to 1.8 in 17 photos of uncovered eyes, some in hard shadow. Quartiles ignore glints."""


CUT = 0.015
"""How far the outline has to lie outside the photo for a face to count as cut, as a share of its larger extent.

Measured on 31 photos that were cut: at most 0.007 where the photo ends with the face, from 0.019 where 6 % are away."""


def photo_warnings(pixels: UInt8, landmarks: Float64) -> tuple[WarningCode, ...]:
    """What the pixels tell of one face.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: (468, 3) float64 photo pixels.
    """
    codes: list[WarningCode] = []
    outline = landmarks[list(OVAL), :2]
    beyond = max(float(-outline.min()), float((outline - pixels.shape[1::-1]).max()))
    if beyond > CUT * float(np.ptp(landmarks[:, :2], axis=0).max()):
        codes.append("face-at-edge")
    face = _luminance(pixels, outline)
    # 75th percentile of a face's linear luminance below which it is under-exposed (dark skin in good light has 0.15).
    if face.size and float(np.percentile(face, 75)) < 0.05:
        codes.append("under-exposed")
    pairs = zip((RIMS["right"], RIMS["left"]), CHEEKS, strict=True)
    if all(_covered(pixels, landmarks[list(eye), :2], landmarks[list(cheek), :2]) for eye, cheek in pairs):
        codes.append("eyes-covered")
    return tuple(codes)


def _covered(pixels: UInt8, eye: Float64, cheek: Float64) -> bool:
    """Whether an eye is much darker than its cheek and without contrast; False where either is out of view."""
    centre = eye.mean(0)
    # Factor by which eye outlines are enlarged about their centre, to take in lids and lashes.
    inside, skin = _luminance(pixels, centre + (eye - centre) * 1.6), _luminance(pixels, cheek)
    if not inside.size or not skin.size:
        return False
    low, high = (float(v) for v in np.percentile(inside, (25, 75)))
    return high < COVERED_LEVEL * float(np.median(skin)) and high - low <= COVERED_CONTRAST * float(inside.mean())


def _luminance(pixels: UInt8, polygon: Float64) -> Float64:
    """(M,) linear luminance in [0, 1] of the pixels inside an (N, 2) polygon; empty where it lies outside the photo."""
    return np.asarray(luma(srgb_to_linear(inside_rim(pixels, polygon, 0.0)[0])), np.float64)
