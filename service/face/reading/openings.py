"""Lids, lips and expression: networks that find both edges of an opening, and MediaPipe's expression scores.

The edges' recipe is ``models/training/openings.py``, in a patch round the corners. The landmark network draws its rims
round eyes that it expects to be open; these networks were taught on eyes and mouths in all states, closed ones and
winks among them. The scores of 51 ARKit units say what the face does, not how far each unit of our head has to go for
it: they are a prior of the fit.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from service.arrays import Float64, UInt8
from service.errors import NumericFault
from service.face.detection import face_square
from service.face.features.rims import RIMS
from service.face.region import Region
from service.runtime.sessions import Session, load_session

log = logging.getLogger(__name__)

STATIONS: Float64 = np.linspace(0.1, 0.9, 9)
"""Places from corner to corner at which the heights of both edges are read."""
ENDS: Float64 = np.array([0.0, *STATIONS, 1.0])
UNSURE = 0.09
"""Median standard deviation, over the length of the opening, above which what was read is not used."""


@dataclass(frozen=True)
class OpeningKind:
    """How the patch of one kind of opening is cut: the corners lie level in it.

    Attributes:
        name: of the network's file.
        side: pixels of the square patch.
        length: pixels between the corners.
        level: row of the corners.
        corners: landmarks of the corners, image-left first, by opening.
        flipped: openings whose patches are mirrored, so that the outer corner comes first.
    """

    name: str
    side: int
    length: float
    level: float
    corners: dict[str, tuple[int, int]]
    flipped: tuple[str, ...] = ()

    def region(self, left: Float64, right: Float64) -> Region | None:
        """The patch round two corners (2,), photo pixels; None where they coincide or are not finite."""
        across = right - left
        length = float(np.hypot(*across))
        if not np.isfinite(length) or length < 1e-3:
            return None
        scale, angle = length / self.length, float(np.arctan2(across[1], across[0]))
        down = np.array([-across[1], across[0]]) / length
        middle = (left + right) / 2 + down * (self.side / 2 - self.level) * scale
        return Region(float(middle[0]), float(middle[1]), self.side * scale, angle)


EYE = OpeningKind("lids", 48, 26.0, 24.0, {"right": (33, 133), "left": (362, 263)}, ("left",))
MOUTH = OpeningKind("lips", 64, 36.0, 26.0, {"mouth": (78, 308)})
KINDS = (EYE, MOUTH)


@dataclass(frozen=True)
class Opening:
    """Both edges of an opening in the photo.

    Attributes:
        upper, lower: (9, 2) photo pixels, at ``STATIONS`` from the image-left corner to the image-right one.
        corners: (2, 2) photo pixels.
        sigma: (2, 9) standard deviations of the heights, upper edge first, over the distance of the corners.
    """

    upper: Float64
    lower: Float64
    corners: Float64
    sigma: Float64

    @property
    def sure(self) -> bool:
        """Whether the network knows what it saw."""
        return bool(np.median(self.sigma) < UNSURE)

    def on_edge(self, points: Float64, upper: bool) -> Float64:
        """(K, 2) points moved up or down onto the upper or the lower edge."""
        across = self.corners[1] - self.corners[0]
        square = float(across @ across)
        up = np.array([across[1], -across[0]])
        place = (points - self.corners[0]) @ across / square
        edge = self.upper if upper else self.lower
        height = np.interp(place, ENDS, [0.0, *((edge - self.corners[0]) @ up / square), 0.0])
        return np.asarray(self.corners[0] + place[:, None] * across + height[:, None] * up)


Openings = dict[str, Opening]
"""By name: ``right`` and ``left`` eye of the subject, ``mouth``; those that could not be read are missing."""


class OpeningsNetwork:
    """The networks of both kinds."""

    def __init__(self, sessions: dict[str, Session] | None = None) -> None:
        self._sessions = sessions or {kind.name: load_session(kind.name) for kind in KINDS}

    def __call__(self, pixels: UInt8, landmarks: Float64) -> Openings:
        """What the networks are sure of in an (H, W, 3) uint8 sRGB photo with landmarks (468, >= 2) in its pixels.

        Nothing where a network gives no numbers.
        """
        found: Openings = {}
        for kind in KINDS:
            for name, pair in kind.corners.items():
                left, right = np.asarray(landmarks, np.float64)[list(pair), :2]
                region = kind.region(left, right)
                if region is None:
                    continue
                try:
                    heights = self._heights(kind, region.cut(pixels, kind.side), name in kind.flipped)
                except NumericFault as fault:
                    log.warning("lids and lips are not read: %s", fault)
                    return {}
                found[name] = _placed(heights, left, right)
        return {name: opening for name, opening in found.items() if opening.sure}

    def _heights(self, kind: OpeningKind, patch: UInt8, flipped: bool) -> Float64:
        """(4, 9): heights of upper and lower edge over the length, then their standard deviations."""
        views = [patch[:, ::-1] if flipped else patch]
        if not kind.flipped:  # an opening with two like sides is read from both
            views.append(patch[:, ::-1])
        out = []
        for view in views:
            image = np.ascontiguousarray(view.transpose(2, 0, 1), np.float32)[None] / np.float32(255)
            heights, sigma = self._sessions[kind.name].run({"patch": image})
            out.append(np.concatenate([heights[0], sigma[0]]).astype(np.float64))
        if not kind.flipped:
            out[1] = out[1][:, ::-1]
        mean = np.mean(out, 0)
        return np.asarray(mean[:, ::-1] if flipped else mean)


def _placed(read: Float64, left: Float64, right: Float64) -> Opening:
    across = right - left
    up = np.array([across[1], -across[0]])
    base = left + STATIONS[:, None] * across
    middle, half = (read[0] + read[1]) / 2, np.maximum(read[0] - read[1], 0.0) / 2
    upper, lower = (base + (middle + sign * half)[:, None] * up for sign in (1.0, -1.0))
    return Opening(upper, lower, np.stack([left, right]), read[2:])


def with_openings(landmarks: Float64, openings: Openings) -> Float64:
    """(468, 3) landmarks whose rims of eyes and mouth lie on the edges that were read; corners and depths stay."""
    out = np.array(landmarks, np.float64)
    for name, opening in openings.items():
        rim = RIMS[name]
        half = len(rim) // 2
        for part, upper in ((rim[1:half], False), (rim[half + 1 :], True)):
            out[list(part), :2] = opening.on_edge(out[list(part), :2], upper)
    return out


SCORED_SIDE, POINTS = 256, 478

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


Scores = dict[str, float]
"""Score in [0, 1] of each ARKit unit; there is none of tongueOut."""


class Landmarker:
    """Both networks."""

    def __init__(self, sessions: tuple[Session, Session] | None = None) -> None:
        self._points, self._scores = sessions or (load_session("face_landmarker"), load_session("face_blendshapes"))

    def __call__(self, pixels: UInt8, landmarks: Float64) -> Scores | None:
        """Look at the face with landmarks (468, >= 2) of an (H, W, 3) uint8 sRGB photo.

        None where the landmarks are not finite or coincide, or a network gives no numbers.
        """
        region = face_square(landmarks) if np.isfinite(landmarks[:, :2]).all() else None
        if region is None or not region.side > 1.0:
            return None
        image = np.ascontiguousarray(region.cut(pixels, SCORED_SIDE), np.float32)[None] / np.float32(255)
        try:
            points = self._points.run({"image": image})[0].reshape(POINTS, 3)[:, :2].astype(np.float64)
            taken = points[list(SUBSET)].astype(np.float32)[None]
            scores = np.clip(np.asarray(self._scores.run({"points": taken})[0], np.float64).ravel(), 0.0, 1.0)
        except NumericFault as fault:
            log.warning("the expression is not scored: %s", fault)
            return None
        return {name: float(score) for name, score in zip(NAMES, scores, strict=True) if name != "_neutral"}
