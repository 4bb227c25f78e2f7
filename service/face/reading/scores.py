"""Expression scores of MediaPipe's Face Landmarker: 478 points in a crop, and 51 ARKit units from 146 of them.

The points are finer at eyes, irises and lips than those of ``service.face.landmarks``. The scores say what the face
does, not how far each unit of our head has to go for it: they are a prior of the fit.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from service.arrays import Float64, UInt8
from service.errors import NumericFault
from service.face.landmarks import EYE_LEFT, EYE_RIGHT, MOUTH
from service.face.region import Region, roll
from service.runtime.sessions import Session, load_session

log = logging.getLogger(__name__)

SIDE, POINTS = 256, 478
FILL = 1.5
"""Side of the crop over the longer side of the landmarks' bounding box (MediaPipe)."""

# fmt: off
SUBSET = (
    0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63, 65, 66, 67, 70, 78, 80,
    81, 82, 84, 87, 88, 91, 93, 95, 103, 105, 107, 109, 127, 132, 133, 136, 144, 145, 146, 148, 149, 150, 152, 153,
    154, 155, 157, 158, 159, 160, 161, 162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251,
    263, 267, 269, 270, 276, 282, 283, 284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310, 311, 312, 314, 317, 318,
    321, 323, 324, 332, 334, 336, 338, 356, 361, 362, 365, 373, 374, 375, 377, 378, 379, 380, 381, 382, 384, 385, 386,
    387, 388, 389, 390, 397, 398, 400, 402, 405, 409, 415, 454, 466, 468, 469, 470, 471, 472, 473, 474, 475, 476, 477,
)
"""Points that the network of scores takes (MediaPipe, face_blendshapes_graph.cc)."""
NAMES = (
    "_neutral", "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff",
    "cheekSquintLeft", "cheekSquintRight", "eyeBlinkLeft", "eyeBlinkRight", "eyeLookDownLeft", "eyeLookDownRight",
    "eyeLookInLeft", "eyeLookInRight", "eyeLookOutLeft", "eyeLookOutRight", "eyeLookUpLeft", "eyeLookUpRight",
    "eyeSquintLeft", "eyeSquintRight", "eyeWideLeft", "eyeWideRight", "jawForward", "jawLeft", "jawOpen", "jawRight",
    "mouthClose", "mouthDimpleLeft", "mouthDimpleRight", "mouthFrownLeft", "mouthFrownRight", "mouthFunnel",
    "mouthLeft", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthPressLeft", "mouthPressRight", "mouthPucker",
    "mouthRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthSmileLeft",
    "mouthSmileRight", "mouthStretchLeft", "mouthStretchRight", "mouthUpperUpLeft", "mouthUpperUpRight",
    "noseSneerLeft", "noseSneerRight",
)
"""Of the scores, in their order."""
# fmt: on


@dataclass(frozen=True)
class Scores:
    """What the Face Landmarker says of one face.

    Attributes:
        points: (478, 2) photo pixels, the last ten on the irises.
        units: score in [0, 1] by ARKit name; there is none of tongueOut.
    """

    points: Float64
    units: dict[str, float]


class Landmarker:
    """Both networks."""

    def __init__(self, sessions: tuple[Session, Session] | None = None, threads: int = 2) -> None:
        self._points, self._scores = sessions or (
            load_session("face_landmarker", threads),
            load_session("face_blendshapes", threads),
        )

    def __call__(self, pixels: UInt8, landmarks: Float64) -> Scores | None:
        """Look at the face with landmarks (468, >= 2) of an (H, W, 3) uint8 sRGB photo; None where they give no crop.

        Raises:
            NumericFault: a network gives no numbers.
        """
        region = crop_of(landmarks)
        if region is None:
            return None
        image = np.ascontiguousarray(region.cut(pixels, SIDE), np.float32)[None] / np.float32(255)
        points = self._points.run({"image": image})[0].reshape(POINTS, 3)[:, :2].astype(np.float64)
        taken = points[list(SUBSET)].astype(np.float32)[None]
        scores = np.clip(np.asarray(self._scores.run({"points": taken})[0], np.float64).ravel(), 0.0, 1.0)
        units = {name: float(score) for name, score in zip(NAMES, scores, strict=True) if name != "_neutral"}
        return Scores(region.to_photo(points, SIDE), units)


def crop_of(landmarks: Float64) -> Region | None:
    """The square that MediaPipe cuts: level with the eyes, on the middle of the landmarks' bounding box."""
    flat = np.asarray(landmarks, np.float64)[:, :2]
    if not np.isfinite(flat).all():
        return None
    angle = roll(*(flat[list(pair)].mean(0) for pair in (EYE_LEFT, EYE_RIGHT, MOUTH)))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    level = flat @ turn.T
    low, high = level.min(0), level.max(0)
    side = float((high - low).max()) * FILL
    x, y = turn.T @ ((low + high) / 2)
    return Region(float(x), float(y), side, angle) if side > 1.0 else None


def read_scores(pixels: UInt8, landmarks: Float64, network: Landmarker) -> Scores | None:
    """As the networks say; None where they give no numbers."""
    try:
        return network(pixels, landmarks)
    except NumericFault as fault:
        log.warning("the expression is not scored: %s", fault)
        return None
