"""The 468-point face mesh: search for the roll, iteration of the region to convergence, agreement with the detector.

Kartynnik et al., "Real-time Facial Surface Geometry from Monocular Video on Mobile GPUs", 2019. The network returns a
well-formed mesh for any region, and its presence probability saturates: it is 1 to seven digits even for regions that
hold a turned or half a face. Two measures discriminate: the presence *logit* (over 28 on upright faces up to 45 degrees
of yaw, 13 and more at 75, under 8 upside down or beside the face, negative on textures) and the distance to the
keypoints of the detector, which is an independent network.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Float64, UInt8
from service.face.detector import Detection
from service.face.region import Region, level_square, roll
from service.face.topology import MIRROR
from service.runtime.sessions import Session, load_session

INPUT_SIZE = 192
"""Side of the network's input, pixels."""
LANDMARKS = 468
REGION_SCALE = 1.5
"""Side of the network's region over the longer side of the box, or of the landmarks' bounding box (MediaPipe)."""
MOST_STEPS = 5
"""Most iterations of the region."""
CONVERGED = 0.01
"""Change of position and size over the side, and of the angle in radians, below which a region has converged."""
CLEAR = 20.0
"""Presence logit from which a region is accepted without trying others."""
HOPELESS = -6.0
"""Presence logit below which no other start is tried; even full profiles are above it."""
STRONG = 0.85
"""Detector score from which a mesh without evidence is tried from other starts; textures score lower."""
LOGIT_SCALE = 10.0
"""Difference of presence logits at which the better of two answers weighs e : 1 (from a yaw sweep of a known head)."""
LARGEST_LOSS = 10.0
"""Loss of presence logit above which an iteration is rejected."""
LARGEST_SHIFT = 0.6
"""Distance of the mesh's centre from the box's, over the box size, above which the mesh is of something else."""
EYE_LEFT, EYE_RIGHT, NOSE, MOUTH = (33, 133), (362, 263), (1, 4), (13, 14)
"""Mesh points whose mean corresponds to the detector's image-left eye, image-right eye, nose tip and mouth."""


@dataclass(frozen=True)
class Mesh:
    """One answer of the landmark network.

    Attributes:
        landmarks: (468, 3) float64 photo pixels, z away from the camera.
        logit: log-odds that the region held a face in the expected position.
    """

    landmarks: Float64
    logit: float

    @property
    def presence(self) -> float:
        """The network's face probability in [0, 1]."""
        return 1 / (1 + float(np.exp(-np.clip(self.logit, -80, 80))))

    @property
    def keypoints(self) -> Float64:
        """(4, 2) eyes, nose tip and mouth, comparable to the first four of ``Detection.keypoints``."""
        return np.stack([self.landmarks[list(pair), :2].mean(0) for pair in (EYE_LEFT, EYE_RIGHT, NOSE, MOUTH)])

    @property
    def region(self) -> Region:
        """The region for the next iteration: the bounding square of the landmarks, level with the face, enlarged."""
        square = face_square(self.landmarks)
        return replace(square, side=max(square.side, REGION_SCALE))

    def disagreement(self, detection: Detection) -> float:
        """Mean distance of the four keypoints from the detector's, over the box size."""
        gaps = np.linalg.norm(self.keypoints - detection.keypoints[:4], axis=1)
        return float(gaps.mean() / max(detection.size, 1e-6))


def face_roll(landmarks: Float64) -> float:
    """Radians by which a face with landmarks (468, >= 2) is turned clockwise; 0 where eyes or mouth are not finite."""
    ends = [np.nanmean(landmarks[list(pair), :2], 0) for pair in (EYE_LEFT, EYE_RIGHT, MOUTH)]
    return roll(*ends) if np.isfinite(ends).all() else 0.0


def face_square(landmarks: Float64) -> Region:
    """The square that MediaPipe's networks of a face see: level with it, round its landmarks (468, >= 2), enlarged."""
    return level_square(landmarks[:, :2], face_roll(landmarks), REGION_SCALE)


class MeshNetwork:
    """The landmark network applied to square regions."""

    def __init__(self, session: Session | None = None, threads: int = 2) -> None:
        self._session = session or load_session("face_mesh", threads)

    def __call__(self, pixels: UInt8, region: Region) -> Mesh:
        """The network's answer for one square region of an (H, W, 3) uint8 sRGB photo."""
        return self._run(region.cut(pixels, INPUT_SIZE), region)

    def both_ways(self, pixels: UInt8, region: Region) -> Mesh:
        """The average of the answers to the crop and to its mirror image, weighted by the odds of their presence.

        The network is not symmetric: its presence logit falls from 60 to 35 when a face at 30 degrees of yaw is
        mirrored, and the landmarks differ by 3 to 5 % of the inter-ocular distance. The average treats both sides
        alike, so that a mirrored photo gives the mirrored mesh.
        """
        crop = region.cut(pixels, INPUT_SIZE)
        plain = self._run(crop, region)
        opposite = self._run(crop[:, ::-1], Region(0.0, 0.0, float(INPUT_SIZE)))
        local = opposite.landmarks[list(MIRROR)] * [-1.0, 1.0, 1.0] + [INPUT_SIZE / 2, INPUT_SIZE / 2, 0.0]
        share = 1 / (1 + float(np.exp(np.clip((opposite.logit - plain.logit) / LOGIT_SCALE, -20, 20))))
        landmarks = share * plain.landmarks + (1 - share) * region.to_photo(local, INPUT_SIZE)
        return Mesh(landmarks, max(plain.logit, opposite.logit))

    def _run(self, crop: UInt8, region: Region) -> Mesh:
        raw, flag = self._session.run({"image": np.ascontiguousarray(crop, np.float32)[None] / 255})
        return Mesh(region.to_photo(raw.reshape(LANDMARKS, 3), INPUT_SIZE), float(flag.ravel()[0]))


def locate(network: MeshNetwork, pixels: UInt8, detection: Detection) -> Mesh:
    """The most convincing mesh near a detection.

    The detector finds faces at any roll but reports each as if it were upright, so the four quarter turns are tried
    first, until one is clear. If none is, wider, narrower, turned and shifted regions follow, unless the evidence so
    far speaks against a face. The best region is iterated to convergence.
    """
    region = detection.region(REGION_SCALE)
    best = _first_clear(network, pixels, (_turned(region, k * np.pi / 2) for k in range(4)))
    if best[1].logit < (HOPELESS if detection.score >= STRONG else 0.0):
        return best[1]
    if best[1].logit < CLEAR:
        best = _first_clear(network, pixels, _around(best[0]), best)
    return _iterated(network, pixels, best[1], detection)


def _first_clear(
    network: MeshNetwork, pixels: UInt8, regions: Iterable[Region], best: tuple[Region, Mesh] | None = None
) -> tuple[Region, Mesh]:
    for region in regions:
        mesh = network(pixels, region)
        if best is None or mesh.logit > best[1].logit:
            best = region, mesh
        if mesh.logit >= CLEAR:
            break
    if best is None:
        raise ValueError("no region to try")
    return best


def _turned(region: Region, angle: float) -> Region:
    return Region(region.x, region.y, region.side, region.angle + angle)


def _around(region: Region) -> list[Region]:
    """Other starts around a region: narrower, wider, turned, shifted along the axes of the face."""
    others = [Region(region.x, region.y, region.side * s, region.angle) for s in (0.8, 1.3)]
    others += [_turned(region, a) for a in (0.35, -0.35)]
    for across, down in ((0.15, 0.0), (-0.15, 0.0), (0.0, 0.15), (0.0, -0.15)):
        point = region.to_photo(np.array([[0.5 + across, 0.5 + down]]), 1)[0]
        others.append(Region(float(point[0]), float(point[1]), region.side, region.angle))
    return others


def _iterated(network: MeshNetwork, pixels: UInt8, mesh: Mesh, detection: Detection) -> Mesh:
    """Move the region to its landmarks until it converges; a mesh that leaves the box or loses evidence is rejected."""
    best, region = mesh, mesh.region
    for _ in range(MOST_STEPS):
        mesh = network.both_ways(pixels, region)
        following = mesh.region
        gap = np.hypot(*(mesh.landmarks[:, :2].mean(0) - detection.centre))
        if gap > LARGEST_SHIFT * detection.size or mesh.logit < best.logit - LARGEST_LOSS:
            break
        best = mesh
        if _moved(region, following) < CONVERGED:
            break
        region = following
    return best


def _moved(one: Region, other: Region) -> float:
    """Largest of shift and growth over the side, and turn in radians."""
    turn = abs((other.angle - one.angle + np.pi) % (2 * np.pi) - np.pi)
    shift = np.hypot(other.x - one.x, other.y - one.y) / one.side
    return float(max(shift, abs(other.side - one.side) / one.side, turn))
