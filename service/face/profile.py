"""Faces that the landmark network does not see, or sees turned too little: from 60 degrees of yaw on, its presence
falls though a face is there, and its landmarks stop short of the head's turn.

The detector still finds them, and the reader, which was taught with heads turned by up to 75 degrees, says of every
pixel which place of the head it shows. Its places give a pose, and the pose the landmarks that the fit starts from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Float64, UInt8
from service.errors import NumericFault
from service.face.detection import Detection
from service.face.finder import LANDMARK_COUNT, Face, photo_warnings
from service.face.fit.dense import correspondences
from service.face.fit.landmark_fit import LandmarkModel, at_barycentric
from service.face.fit.solver import State, WeakPose, weak_pose
from service.face.reading.reader import ReaderNetwork, Reading, crop_of
from service.face.region import Region
from service.head.model import HeadModel
from service.robust import geman_mcclure

CROP = 1.8
"""Side of the first crop over that of the detector's box, so that the face fills it as the portraits were filled."""
LOOKS = 3
"""How often the face is read, each time in the crop that the landmarks of the time before ask for."""
ROUNDS = 6
"""Rounds of weights of one pose."""
FEWEST_CELLS = 1000
"""Fewest cells with a place on the head, of 4096, that make a face: profiles have 1500 to 2500."""
AGREEMENT, NEAR_MM = 0.6, 8.0
"""Least share of the cells that lie within so many millimetres of the average head in the pose found."""
TURNED_DEG, FURTHER_DEG = 45.0, 17.0
"""Turn of the landmarks from which on they may be a guess, and by how much further the reader sees the head turned
where they are: right ones fit the shape better than the reader's, by a tenth."""
REACH_M = 0.012
"""Distance on the head over which a landmark follows the cells around it, metres."""


@dataclass(frozen=True)
class Profile:
    """A face as the reader sees it.

    Attributes:
        landmarks: (468, 3) photo pixels, the third away from the camera.
        share: of the cells that agree with the pose, in [0, 1].
        cells: how many cells have a place on the head.
        yaw_deg: turn of the head.
    """

    landmarks: Float64
    share: float
    cells: int
    yaw_deg: float


def faces_by_reading(pixels: UInt8, doubted: list[Detection], head: HeadModel, network: ReaderNetwork) -> list[Face]:
    """The best of the detector's boxes in which the reader sees a face; empty where it sees none.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        doubted: boxes in which the landmark network saw no face (``FaceFinder.doubted``), best first.
        head: average head with the landmark embedding.
        network: the reader.

    Returns:
        At most one face, with the warning ``landmarks-read``: its landmarks come from the reader.
    """
    model = LandmarkModel(head, 0)
    for detection in doubted:
        # Least share of a box inside the photo: beyond it all is black, of which the reader knows nothing.
        if _inside(detection, pixels) < 0.5:
            continue
        seen = look(pixels, detection.region(CROP), head, model, network)
        if seen is not None and seen.cells >= FEWEST_CELLS and seen.share >= AGREEMENT:
            warnings = ("landmarks-read", *photo_warnings(pixels, seen.landmarks))
            return [Face(detection.box, detection.score, detection.keypoints, seen.landmarks, 0.0, warnings)]
    return []


def turned_further(face: Face, reading: Reading, head: HeadModel) -> Face:
    """The face; with the reader's landmarks and ``landmarks-read`` where it sees the head turned much further.

    Args:
        face: with landmarks of the landmark network.
        reading: read in the crop of these.
        head: average head with the landmark embedding.
    """
    model = LandmarkModel(head, 0)
    told = weak_pose(model.at_yaw(0.0).mean, face.landmarks[:, :2], np.ones(LANDMARK_COUNT)).yaw_deg
    if abs(told) < TURNED_DEG:
        return face
    seen = _profile(head, model, reading)
    if seen is None or seen.share < AGREEMENT or seen.yaw_deg * np.sign(told) < abs(told) + FURTHER_DEG:
        return face
    return replace(face, landmarks=seen.landmarks, presence=0.0, warnings=("landmarks-read", *face.warnings))


def _inside(detection: Detection, pixels: UInt8) -> float:
    """Share of a box's area that lies in the photo."""
    size = np.array(pixels.shape[1::-1], np.float64)
    low, high = np.clip(detection.box[:2], 0.0, size), np.clip(detection.box[2:], 0.0, size)
    return float(np.prod(high - low)) / max(float(np.prod(detection.box[2:] - detection.box[:2])), 1e-9)


def look(
    pixels: UInt8, region: Region, head: HeadModel, model: LandmarkModel, network: ReaderNetwork
) -> Profile | None:
    """The face in a square of the photo, read ``LOOKS`` times; None where the reader finds no place of the head."""
    seen, crop = None, region
    for _ in range(LOOKS):
        try:
            seen = _profile(head, model, network(pixels, crop))
        except NumericFault:
            return None
        further = None if seen is None else crop_of(seen.landmarks)
        if further is None:
            return None
        crop = further
    return seen


def _profile(head: HeadModel, model: LandmarkModel, reading: Reading) -> Profile | None:
    """Pose of the average head on the cells, and its landmarks in that pose, moved with the cells around them."""
    ahead = State(np.diag([1.0, -1.0, -1.0]), np.zeros(2), 0.0, 0.0, np.zeros(0))  # places need no pose
    found = correspondences(head, reading, ahead, np.zeros(2))
    if len(found.pixels) < 4:
        return None
    points = at_barycentric(head.mean, found.corners, found.weights)
    # Least extent of the cells' places on the head, metres: places that lie together tell no pose.
    if float(np.ptp(points, axis=0).max()) < 0.05:
        return None
    certain = found.sure / np.maximum(found.sigma_mm, 1e-9) ** 2
    weight, pose = certain, weak_pose(points, found.pixels, certain)
    for _ in range(ROUNDS):
        apart = np.linalg.norm(_shown(pose, points)[:, :2] - found.pixels, axis=1)
        scale = pose.scale * 1e-3 * max(NEAR_MM, 1e3 * float(np.median(apart)) / pose.scale)
        weight = certain * geman_mcclure(apart, scale)
        pose = weak_pose(points, found.pixels, weight)
    off = found.pixels - _shown(pose, points)[:, :2]
    agrees = np.linalg.norm(off, axis=1) < NEAR_MM * 1e-3 * pose.scale
    yaw = pose.yaw_deg
    places = model.at_yaw(yaw).mean
    landmarks = _shown(pose, places)
    if landmarks.shape != (LANDMARK_COUNT, 3) or not np.isfinite(landmarks).all():
        return None
    near = np.exp(-((places[:, None] - points[None]) ** 2).sum(-1) / (2.0 * REACH_M**2)) * (weight * agrees)
    total = near.sum(1, keepdims=True)
    typical = float(np.median(certain))  # a landmark without cells around it stays where the pose has it
    landmarks[:, :2] += near @ off / (total + max(typical, 1e-12))
    return Profile(landmarks, float(agrees.mean()), len(points), yaw)


def _shown(pose: WeakPose, points: Float64) -> Float64:
    """(N, 3) photo pixels of head points in a pose, the third away from the camera."""
    turned = pose.scale * points @ pose.rotation.T
    turned[:, :2] += pose.offset
    return np.asarray(turned)
