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
from service.face.landmarks import face_square
from service.runtime.sessions import Session, load_session

log = logging.getLogger(__name__)

SIDE, POINTS = 256, 478

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
        """Look at the face with landmarks (468, >= 2) of an (H, W, 3) uint8 sRGB photo.

        None where the landmarks are not finite or coincide, or a network gives no numbers.
        """
        region = face_square(landmarks) if np.isfinite(landmarks[:, :2]).all() else None
        if region is None or not region.side > 1.0:
            return None
        image = np.ascontiguousarray(region.cut(pixels, SIDE), np.float32)[None] / np.float32(255)
        try:
            points = self._points.run({"image": image})[0].reshape(POINTS, 3)[:, :2].astype(np.float64)
            taken = points[list(SUBSET)].astype(np.float32)[None]
            scores = np.clip(np.asarray(self._scores.run({"points": taken})[0], np.float64).ravel(), 0.0, 1.0)
        except NumericFault as fault:
            log.warning("the expression is not scored: %s", fault)
            return None
        units = {name: float(score) for name, score in zip(NAMES, scores, strict=True) if name != "_neutral"}
        return Scores(region.to_photo(points, SIDE), units)
