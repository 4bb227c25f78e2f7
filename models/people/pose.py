"""Cameras by seed: how the head is turned, from how near it is seen, and how tightly the picture is cropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.shoot import look_at
from models.lightstage.skin.streams import Stream
from service.geometry.camera import Camera
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

NEAREST_M, FARTHEST_M = 0.28, 3.5
"""Distance of the face from the camera: an arm's length selfie to a tele lens."""


@dataclass(frozen=True)
class Framing:
    """How tightly a picture is cropped.

    Attributes:
        fill: least and greatest of the longer side of the landmarks' bounding box over the picture's.
        above: how far the middle of the landmarks stands above the picture's, over its side, on average.
    """

    fill: tuple[float, float]
    above: float


FRAMINGS = {"face": Framing((0.45, 0.86), 0.03), "hair": Framing((0.34, 0.46), 0.05)}
"""Of portraits to read faces in, and of wider ones that hold all of the hair (``service.face.reading.reader``: its
``HEAD_FILL``)."""


def draw_camera(seed: int, size: int, face: Float, framing: Framing = FRAMINGS["face"]) -> Camera:
    """A camera that holds the face in a square picture.

    Args:
        seed: names the camera.
        size: side of the picture, pixels.
        face: (L, 3) landmarks of the face in head space, metres.
        framing: how tightly the face is cropped.
    """
    s = Stream(seed, "camera")
    wide = s.chance(0.3)
    yaw = s.one(-100.0, 100.0) if wide else float(np.clip(s.normal(0.0, 18.0)[0], -60, 60))
    pitch = float(np.clip(s.normal(0.0, 14.0 if wide else 8.0)[0], -35.0, 35.0))
    roll = float(np.clip(s.normal(0.0, 15.0 if s.chance(0.25) else 5.0)[0], -45.0, 45.0))
    distance = float(np.exp(s.one(np.log(NEAREST_M), np.log(FARTHEST_M))))
    first = look_at(yaw, pitch, roll, distance, size, 1.0)
    # The head may stand beside the optical axis: pictures of several people, crops.
    aside = s.normal(0.0, 0.12, 2) * distance
    centre = np.array([aside[0], aside[1], distance])
    middle = face.mean(0)
    translation = centre - first.rotation @ middle
    seen = face @ first.rotation.T + translation
    flat = seen[:, :2] / seen[:, 2:]
    low, high = flat.min(0), flat.max(0)
    focal = s.one(*framing.fill) * size / float((high - low).max())
    jitter = s.normal(0.0, 0.05, 2) * size
    principal = size / 2 + jitter - focal * 0.5 * (low + high) - np.array([0.0, framing.above * size])
    return Camera(size, size, focal, principal, first.rotation, translation)


def landmarks(head: HeadModel, vertices: npt.NDArray[np.floating]) -> Float:
    """(478, 3) landmark points: MediaPipe's 468 by the head's embedding, then the irises.

    The subject's right iris comes first: centre, then the rim to the right (as a picture from the front shows it), up,
    left and down.
    """
    corners = vertices[head.triangles[head.landmark_triangle]].astype(np.float64)
    points = np.einsum("lk,lkc->lc", head.landmark_barycentric.astype(np.float64), corners)
    irises = []
    for name in ("eye_right", "eye_left"):
        first = int(head.triangles[head.triangle_part == head.part_names.index(name)].min())
        ring = vertices[first + 1 + 6 * 24 : first + 1 + 7 * 24].astype(
            np.float64
        )  # the limbus, see models.head.settle
        turned = ring if name == "eye_left" else ring[(12 - np.arange(24)) % 24]  # the right ball is a mirror image
        irises += [ring.mean(0), *turned[[0, 6, 12, 18]]]
    return np.concatenate([points, np.array(irises)])


def contour(head: HeadModel, vertices: npt.NDArray[np.floating], yaw_deg: float) -> tuple[npt.NDArray[np.int32], Float]:
    """Indices and (C, 3) places of the landmarks of the outline as they slide over the surface with the yaw."""
    if not len(head.contour_landmarks):
        return head.contour_landmarks, np.zeros((0, 3))
    bins = head.contour_yaw_deg
    upper = int(np.clip(np.searchsorted(bins, yaw_deg), 1, len(bins) - 1))
    share = float(np.clip((yaw_deg - bins[upper - 1]) / (bins[upper] - bins[upper - 1]), 0.0, 1.0))
    points = [
        np.einsum("lk,lkc->lc", head.contour_barycentric[b], vertices[head.triangles[head.contour_triangle[b]]])
        for b in (upper - 1, upper)
    ]
    return head.contour_landmarks, np.asarray((1.0 - share) * points[0] + share * points[1], np.float64)
