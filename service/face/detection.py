"""The two networks that find faces: BlazeFace's boxes, and the 468-point mesh, iterated until its region converges.

Bazarevsky et al., "BlazeFace: Sub-millisecond Neural Face Detection on Mobile GPUs", 2019; constants as in MediaPipe's
``face_detection_back`` graph (256 pixels, strides 16, 32, 32, 32). Kartynnik et al., "Real-time Facial Surface Geometry
from Monocular Video on Mobile GPUs", 2019: the network returns a well-formed mesh for any region, and its presence
probability saturates: it is 1 to seven digits even for regions that hold a turned or half a face. Two measures
discriminate: the presence *logit* (over 28 on upright faces up to 45 degrees of yaw, 13 and more at 75, under 8 upside
down or beside the face, negative on textures) and the distance to the keypoints of the detector, which is an
independent network.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, Float64, UInt8
from service.face.region import Region, level_square, roll
from service.runtime.sessions import load_session

DETECTOR_SIZE = 256
"""Side of the network's input, pixels."""
STRIDES = (16, 32, 32, 32)
MERGE_OVERLAP = 0.3
"""Intersection over union above which two boxes are the same face (MediaPipe's min_suppression_threshold)."""
LOGIT_LIMIT = 80.0
"""Magnitude at which raw scores are clipped, so that the sigmoid's exponential does not overflow."""


@dataclass(frozen=True)
class Detection:
    """One face as the detector sees it, in photo pixels.

    Attributes:
        centre: (2,) float64 centre of the box.
        size: longer edge of the box.
        score: probability in [0, 1].
        keypoints: (6, 2) float64, in the order of ``Face.keypoints``.
    """

    centre: Float64
    size: float
    score: float
    keypoints: Float64

    @property
    def box(self) -> Float64:
        """(4,) x0, y0, x1, y1 of the upright square."""
        half = self.size / 2
        return np.concatenate([self.centre - half, self.centre + half])

    @property
    def angle(self) -> float:
        """Roll of the face in radians, clockwise."""
        return roll(self.keypoints[0], self.keypoints[1], self.keypoints[3])

    def region(self, scale: float) -> Region:
        """A square around the box, ``scale`` times its size, turned so that the eyes are level."""
        return Region(float(self.centre[0]), float(self.centre[1]), self.size * scale, self.angle)


def anchors() -> Float64:
    """(A, 2) float64 anchor centres in input pixels: two per cell and layer, layers of equal stride together.

    >>> anchors().shape
    (896, 2)
    """
    parts = []
    for stride in sorted(set(STRIDES)):
        cells = DETECTOR_SIZE // stride
        line = (np.arange(cells) + 0.5) * stride
        grid = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
        parts.append(np.repeat(grid, 2 * STRIDES.count(stride), axis=0))
    return np.concatenate(parts)


def decode_boxes(regressors: AnyFloat, logits: AnyFloat, grid: Float64, threshold: float) -> tuple[Float64, Float64]:
    """Boxes and keypoints in input pixels.

    Args:
        regressors: (A, 16) offsets x, y, w, h and six keypoints, in input pixels relative to the anchor.
        logits: (A,) raw scores, clipped to +-80 before the sigmoid.
        grid: (A, 2) anchor centres in input pixels.
        threshold: smallest probability kept.

    Returns:
        (N, 8, 2) rows of centre, size and six keypoints, and (N,) probabilities, best first; empty boxes are dropped.
    """
    scores = 1 / (1 + np.exp(-np.clip(np.asarray(logits, np.float64), -LOGIT_LIMIT, LOGIT_LIMIT)))
    points = np.asarray(regressors, np.float64).reshape(-1, 8, 2).copy()
    points[:, 0] += grid
    points[:, 2:] += grid[:, None]
    keep = np.flatnonzero((scores >= threshold) & (points[:, 1] > 1).all(1))
    keep = keep[np.argsort(-scores[keep], kind="stable")]
    return points[keep], scores[keep]


def overlap(one: Float64, others: Float64) -> Float64:
    """(N,) intersection over union of a (4,) box with (N, 4) boxes x0, y0, x1, y1; 0 where both are empty."""
    low = np.maximum(one[:2], others[:, :2])
    high = np.minimum(one[2:], others[:, 2:])
    shared = np.prod(np.maximum(high - low, 0), 1)
    areas = np.prod(np.maximum(others[:, 2:] - others[:, :2], 0), 1)
    union = np.prod(np.maximum(one[2:] - one[:2], 0)) + areas - shared
    return np.asarray(np.divide(shared, union, out=np.zeros_like(shared), where=union > 0))


def merge(found: list[Detection], limit: float = MERGE_OVERLAP) -> list[Detection]:
    """Average detections of the same face, weighted by score, best first (MediaPipe's weighted suppression).

    Greedy suppression would keep one of two boxes that are each half off the face; their average is centred on it.
    """
    rest = sorted(found, key=lambda d: -d.score)
    merged = []
    while rest:
        together = overlap(rest[0].box, np.stack([d.box for d in rest])) > limit
        together[0] = True
        group = [d for d, same in zip(rest, together, strict=True) if same]
        merged.append(_average(group))
        rest = [d for d, same in zip(rest, together, strict=True) if not same]
    return merged


def _average(group: list[Detection]) -> Detection:
    weights = np.maximum([d.score for d in group], 1e-9)
    weights = weights / weights.sum()
    return Detection(
        centre=np.einsum("n,nc->c", weights, np.stack([d.centre for d in group])),
        size=float(weights @ [d.size for d in group]),
        score=max(d.score for d in group),
        keypoints=np.einsum("n,nkc->kc", weights, np.stack([d.keypoints for d in group])),
    )


class Detector:
    """The detector network applied to square regions: crop, run, decode, merge, map back to the photo."""

    def __init__(self) -> None:
        self._session = load_session("face_detector")
        self._anchors = anchors()

    def __call__(self, pixels: UInt8, region: Region, threshold: float) -> list[Detection]:
        """Faces of score >= ``threshold`` in a square of an (H, W, 3) uint8 photo, best first, in photo pixels."""
        crop = region.cut(pixels, DETECTOR_SIZE)
        image = crop.astype(np.float32)[None] / 127.5 - 1
        regressors, logits = self._session.run({"image": image})
        points, scores = decode_boxes(regressors[0], logits[0, :, 0], self._anchors, threshold)
        scale = region.side / DETECTOR_SIZE
        found = []
        for row, score in zip(points, scores, strict=True):
            mapped = region.to_photo(np.concatenate([row[:1], row[2:]]), DETECTOR_SIZE)
            found.append(Detection(mapped[0], float(row[1].max()) * scale, float(score), mapped[1:]))
        return merge(found)


LANDMARKS, FIRST_LEFT = 468, 248
"""Landmarks of the mesh, and the first of those on the image's right half, the subject's left."""
MIDLINE = frozenset({*range(20), 94, 151, 152, 164, 168, 175, 195, 197, 199, 200}) - {3, 7}
"""Landmarks that are their own mirror partners."""


_RIGHT = [k for k in range(FIRST_LEFT) if k not in MIDLINE]
MIRROR = np.arange(LANDMARKS)
"""(468,) index of the mirror partner of each landmark: those of the two halves are numbered in the same order."""
MIRROR[_RIGHT], MIRROR[FIRST_LEFT:] = MIRROR[FIRST_LEFT:].copy(), _RIGHT

MESH_SIZE = 192
"""Side of the network's input, pixels."""
REGION_SCALE = 1.5
"""Side of the network's region over the longer side of the box, or of the landmarks' bounding box (MediaPipe)."""
MOST_STEPS = 5
"""Most iterations of the region."""
CLEAR = 20.0
"""Presence logit from which a region is accepted without trying others."""
STRONG = 0.85
"""Detector score from which a mesh without evidence is tried from other starts; textures score lower."""
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

    def __init__(self) -> None:
        self._session = load_session("face_mesh")

    def __call__(self, pixels: UInt8, region: Region) -> Mesh:
        """The network's answer for one square region of an (H, W, 3) uint8 sRGB photo."""
        return self._run(region.cut(pixels, MESH_SIZE), region)

    def both_ways(self, pixels: UInt8, region: Region) -> Mesh:
        """The average of the answers to the crop and to its mirror image, weighted by the odds of their presence.

        The network is not symmetric: its presence logit falls from 60 to 35 when a face at 30 degrees of yaw is
        mirrored, and the landmarks differ by 3 to 5 % of the inter-ocular distance. The average treats both sides
        alike, so that a mirrored photo gives the mirrored mesh.
        """
        crop = region.cut(pixels, MESH_SIZE)
        plain = self._run(crop, region)
        opposite = self._run(crop[:, ::-1], Region(0.0, 0.0, float(MESH_SIZE)))
        local = opposite.landmarks[MIRROR] * [-1.0, 1.0, 1.0] + [MESH_SIZE / 2, MESH_SIZE / 2, 0.0]
        # Difference of presence logits at which the better of two answers weighs e : 1 (from a yaw sweep of a known
        # head).
        share = 1 / (1 + float(np.exp(np.clip((opposite.logit - plain.logit) / 10.0, -20, 20))))
        landmarks = share * plain.landmarks + (1 - share) * region.to_photo(local, MESH_SIZE)
        return Mesh(landmarks, max(plain.logit, opposite.logit))

    def _run(self, crop: UInt8, region: Region) -> Mesh:
        raw, flag = self._session.run({"image": np.ascontiguousarray(crop, np.float32)[None] / 255})
        return Mesh(region.to_photo(raw.reshape(LANDMARKS, 3), MESH_SIZE), float(flag.ravel()[0]))


def locate(network: MeshNetwork, pixels: UInt8, detection: Detection) -> Mesh:
    """The most convincing mesh near a detection.

    The detector finds faces at any roll but reports each as if it were upright, so the four quarter turns are tried
    first, until one is clear. If none is, wider, narrower, turned and shifted regions follow, unless the evidence so
    far speaks against a face. The best region is iterated to convergence.
    """
    region = detection.region(REGION_SCALE)
    best = _first_clear(network, pixels, [_turned(region, k * np.pi / 2) for k in range(4)])
    # Presence logit below which no other start is tried; even full profiles are above it.
    if best[1].logit < (-6.0 if detection.score >= STRONG else 0.0):
        return best[1]
    if best[1].logit < CLEAR:
        best = _first_clear(network, pixels, _around(best[0]), best)
    return _iterated(network, pixels, best[1], detection)


def _first_clear(
    network: MeshNetwork, pixels: UInt8, regions: Sequence[Region], *known: tuple[Region, Mesh]
) -> tuple[Region, Mesh]:
    found = list(known)
    for region in regions:
        found.append((region, network(pixels, region)))
        if found[-1][1].logit >= CLEAR:
            break
    return max(found, key=lambda one: one[1].logit)


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
        # 0.6: distance of the mesh's centre from the box's, over the box size, above which the mesh is of something
        # else.
        # 10.0: loss of presence logit above which an iteration is rejected.
        if gap > 0.6 * detection.size or mesh.logit < best.logit - 10.0:
            break
        best = mesh
        # Change of position and size over the side, and of the angle in radians, below which a region has converged.
        if _moved(region, following) < 0.01:
            break
        region = following
    return best


def _moved(one: Region, other: Region) -> float:
    """Largest of shift and growth over the side, and turn in radians."""
    turn = abs((other.angle - one.angle + np.pi) % (2 * np.pi) - np.pi)
    shift = np.hypot(other.x - one.x, other.y - one.y) / one.side
    return float(max(shift, abs(other.side - one.side) / one.side, turn))
