"""The frames of a video that show a head from as many sides as it turns: of each direction the sharpest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from service.arrays import UInt8
from service.errors import NoFace
from service.face.face import Face
from service.face.finder import FaceFinder
from service.photo.bundle import MOST
from service.photo.gate import read_photo
from service.photo.video import is_video, sharp_frames

MOST_FRAMES = 9
"""Frames of a video that are used."""
STEP_DEG = 18.0
"""Turn of the head between two of them, about."""
EARS = (234, 454)
"""Landmarks before the image-left and the image-right ear."""
NOSE = 1


def turn_deg(face: Face) -> float:
    """About how far a head is turned, degrees, by where the nose stands between the ears."""
    left, right, nose = (face.landmarks[k, :2] for k in (*EARS, NOSE))
    across = right - left
    width = float(across @ across)
    if width < 1e-9:
        return 0.0
    place = float((nose - left) @ across) / width
    return float(np.degrees(np.arctan((2 * place - 1) * 1.1)))


def best_frames(frames: Sequence[bytes], finder: FaceFinder) -> list[bytes]:
    """JPEG files of at most ``MOST_FRAMES`` frames, the sharpest of each direction.

    Raises:
        NoFace: no frame shows a face.
    """
    best: dict[int, tuple[float, bytes]] = {}
    for data in frames:
        photo = read_photo(data)
        faces = finder.find(photo.pixels)
        if not faces:
            continue
        bin_ = round(turn_deg(faces[0]) / STEP_DEG)
        merit = _sharpness(photo.pixels, faces[0])
        if merit > best.get(bin_, (0.0, b""))[0]:
            best[bin_] = (merit, data)
    if not best:
        raise NoFace(f"none of {len(frames)} frames of the video shows a face")
    chosen = sorted(best, key=lambda one: (abs(one), one))[:MOST_FRAMES]
    return [best[one][1] for one in chosen]


def with_frames(files: Sequence[bytes], finder: Callable[[], FaceFinder]) -> list[bytes]:
    """Files in which each video has been replaced by its best frames, no more than ``MOST`` in all.

    Raises:
        UnreadableInput: a video cannot be read.
        NoFace: it shows none.
    """
    photos = [file for file in files if not is_video(file)]
    for video in (file for file in files if is_video(file)):
        photos += best_frames(sharp_frames(video), finder())[: max(MOST - len(photos), 0)]
    return photos


def _sharpness(pixels: UInt8, face: Face) -> float:
    """Variance of the Laplacian over the face, at one scale for all frames; > 0."""
    low = np.maximum(face.box[:2].astype(int), 0)
    high = np.maximum(face.box[2:].astype(int), low + 8)
    grey = cv2.cvtColor(pixels[low[1] : high[1], low[0] : high[0]], cv2.COLOR_RGB2GRAY)
    if min(grey.shape) < 8:
        return 1e-6
    small = cv2.resize(grey, (200, 200), interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var()) + 1e-6
