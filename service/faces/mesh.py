"""The 468-point face mesh: region, iteration until it stands still, and the check against the detector.

Kartynnik et al., "Real-time Facial Surface Geometry from Monocular Video on Mobile GPUs", 2019. The network answers
with a plausible mesh and full confidence for regions that hold only half a face, so its own flag proves nothing; what
counts is that it agrees with the keypoints that the detector finds independently.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.faces.detector import Detection
from service.faces.region import Region, eye_line_angle
from service.runtime.sessions import Session, load_session

Float = npt.NDArray[np.float64]

INPUT_SIZE = 192
LANDMARKS = 468
REGION_SCALE = 1.5
"""Side of the network's region over the longer side of box or landmarks (MediaPipe)."""
MOST_STEPS = 5
STILL = 0.01
"""A region that moves by less than this part of its side stands still."""
CONSISTENT = 0.12
"""Largest mean distance between mesh and detector keypoints, as a part of the box, that counts as agreement."""
EYE_OUTER = (33, 263)
KEYPOINT_LANDMARKS = ((33, 133), (362, 263), (1, 4), (13, 14))
"""Mesh points whose mean corresponds to the detector's eyes, nose tip and mouth."""


@dataclass(frozen=True)
class Mesh:
    """Result of the landmark network.

    Attributes:
        landmarks: (468, 3) float64 photo pixels, z away from the camera.
        presence: probability that the region held a face, in [0, 1].
        disagreement: mean distance to the detector's keypoints over the box size.
    """

    landmarks: Float
    presence: float
    disagreement: float

    @property
    def consistent(self) -> bool:
        """Whether the mesh lies where the detector sees the face."""
        return self.disagreement <= CONSISTENT and self.presence >= 0.5


class MeshNetwork:
    """The landmark network behind a region."""

    def __init__(self, session: Session | None = None, threads: int = 2) -> None:
        self._session = session or load_session("face_mesh", threads)

    def __call__(self, pixels: npt.NDArray[np.uint8], region: Region) -> tuple[Float, float]:
        """(468, 3) float64 landmarks in photo pixels and the presence probability, for one square region."""
        crop = region.cut(pixels, INPUT_SIZE)
        raw, flag = self._session.run({"image": crop.astype(np.float32)[None] / 255})
        landmarks = region.to_photo(raw.reshape(LANDMARKS, 3), INPUT_SIZE)
        logit = float(np.clip(flag.ravel()[0], -80, 80))
        return landmarks, 1 / (1 + float(np.exp(-logit)))


def landmark_region(landmarks: Float, scale: float = REGION_SCALE) -> Region:
    """The region that landmarks ask for: around their extent along and across the eye line."""
    angle = eye_line_angle(landmarks[EYE_OUTER[0]], landmarks[EYE_OUTER[1]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    level = landmarks[:, :2] @ turn.T
    low, high = level.min(0), level.max(0)
    x, y = turn.T @ ((low + high) / 2)
    return Region(float(x), float(y), max(float((high - low).max()), 1.0) * scale, angle)


def disagreement(landmarks: Float, detection: Detection) -> float:
    """Mean distance of the mesh's eyes, nose tip and mouth from the detector's, over the box size."""
    mesh = np.stack([landmarks[list(pair), :2].mean(0) for pair in KEYPOINT_LANDMARKS])
    return float(np.linalg.norm(mesh - detection.keypoints[:4], axis=1).mean() / max(detection.size, 1e-6))


def settle(network: MeshNetwork, pixels: npt.NDArray[np.uint8], start: Region, detection: Detection) -> Mesh:
    """Run the network, move the region to its landmarks, and repeat until the region stands still.

    Returns the step that agrees best with the detection, so a wandering region cannot make things worse.
    """
    best: Mesh | None = None
    region = start
    for _ in range(MOST_STEPS):
        landmarks, presence = network(pixels, region)
        mesh = Mesh(landmarks, presence, disagreement(landmarks, detection))
        following = landmark_region(landmarks)
        move = float(np.hypot(following.x - region.x, following.y - region.y)) + abs(following.side - region.side)
        settled = move < STILL * region.side and abs(following.angle - region.angle) < STILL
        if best is None or mesh.consistent or mesh.disagreement < best.disagreement:
            best = mesh
        if settled or presence < 0.1:
            break
        region = following
    assert best is not None  # MOST_STEPS > 0  # noqa: S101
    return best


def starts(detection: Detection) -> list[Region]:
    """Regions to try one after another: the detector's own, then shifted, wider, narrower and turned ones."""
    first = detection.region(REGION_SCALE)
    keys = detection.keypoints[:4].mean(0)
    around = Region(float(keys[0]), float(keys[1]), first.side, first.angle)
    tries = [first, around]
    for scale, turn in ((1.25, 0.0), (0.8, 0.0), (1.0, 0.35), (1.0, -0.35), (1.5, 0.0)):
        tries.append(Region(around.x, around.y, first.side * scale, first.angle + turn))
    return tries


def locate(network: MeshNetwork, pixels: npt.NDArray[np.uint8], detection: Detection) -> Mesh:
    """The mesh that agrees with the detection: the first consistent start, else the best of all starts."""
    tried: list[Mesh] = []
    for start in starts(detection):
        mesh = settle(network, pixels, start, detection)
        if mesh.consistent:
            return mesh
        tried.append(mesh)
    return min(tried, key=lambda m: m.disagreement - m.presence * 0.05)
