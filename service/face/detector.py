"""BlazeFace: anchors, decoding of boxes, non-maximum suppression by averaging.

Bazarevsky et al., "BlazeFace: Sub-millisecond Neural Face Detection on Mobile GPUs", 2019; constants as in MediaPipe's
``face_detection_back`` graph (256 pixels, strides 16, 32, 32, 32).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float64, UInt8
from service.face.region import Region, roll
from service.runtime.sessions import Session, load_session

INPUT_SIZE = 256
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


def anchors(size: int = INPUT_SIZE, strides: tuple[int, ...] = STRIDES) -> Float64:
    """(A, 2) float64 anchor centres in input pixels: two per cell and layer, layers of equal stride together.

    >>> anchors().shape
    (896, 2)
    """
    parts = []
    for stride in sorted(set(strides)):
        cells = size // stride
        line = (np.arange(cells) + 0.5) * stride
        grid = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
        parts.append(np.repeat(grid, 2 * strides.count(stride), axis=0))
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

    def __init__(self, session: Session | None = None, threads: int = 2) -> None:
        self._session = session or load_session("face_detector", threads)
        self._anchors = anchors()

    def __call__(self, pixels: UInt8, region: Region, threshold: float = 0.5) -> list[Detection]:
        """Faces of score >= ``threshold`` in a square of an (H, W, 3) uint8 photo, best first, in photo pixels."""
        crop = region.cut(pixels, INPUT_SIZE)
        image = crop.astype(np.float32)[None] / 127.5 - 1
        regressors, logits = self._session.run({"image": image})
        points, scores = decode_boxes(regressors[0], logits[0, :, 0], self._anchors, threshold)
        scale = region.side / INPUT_SIZE
        found = []
        for row, score in zip(points, scores, strict=True):
            mapped = region.to_photo(np.concatenate([row[:1], row[2:]]), INPUT_SIZE)
            found.append(Detection(mapped[0], float(row[1].max()) * scale, float(score), mapped[1:]))
        return merge(found)
