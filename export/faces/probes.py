"""Inputs on which converted networks are compared: seeded noise at several coarsenesses, and a real face."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

SAMPLE = Path(__file__).parents[2] / "service" / "data" / "sample" / "astronaut.png"
SAMPLE_FACE = (150, 30, 310, 190)
"""x0, y0, x1, y1 of a square around the face in the sample photo."""


def noise(size: int, cells: int, seed: int) -> npt.NDArray[np.float32]:
    """(size, size, 3) float32 in [0, 1]: uniform noise of ``cells`` x ``cells`` blocks, linearly interpolated."""
    import cv2

    coarse = np.random.default_rng(seed).random((cells, cells, 3), np.float32)
    return np.asarray(cv2.resize(coarse, (size, size), interpolation=cv2.INTER_LINEAR), np.float32)


def sample_photo() -> npt.NDArray[np.uint8]:
    """(512, 512, 3) uint8 sRGB: the public-domain portrait that the program ships."""
    import cv2

    picture = cv2.imread(str(SAMPLE), cv2.IMREAD_COLOR)
    if picture is None:
        raise FileNotFoundError(f"{SAMPLE}: the sample photo is missing or broken")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)


def face(size: int) -> npt.NDArray[np.float32]:
    """(size, size, 3) float32 sRGB in [0, 1]: the face of the sample photo, enlarged or reduced to a square."""
    import cv2

    x0, y0, x1, y1 = SAMPLE_FACE
    crop = sample_photo()[y0:y1, x0:x1].astype(np.float32) / 255
    return np.asarray(cv2.resize(crop, (size, size), interpolation=cv2.INTER_AREA), np.float32)


def probes(size: int) -> list[npt.NDArray[np.float32]]:
    """Six (size, size, 3) float32 images in [0, 1]: black, white, three noises, one real face."""
    flat = [np.full((size, size, 3), value, np.float32) for value in (0.0, 1.0)]
    return [*flat, *(noise(size, cells, cells) for cells in (4, 16, size)), face(size)]


def point_probes(count: int) -> list[npt.NDArray[np.float32]]:
    """Five (1, count, 2) float32 sets of points, pixels: on rings of several sizes, with noise."""
    random = np.random.default_rng(7)
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    sizes = (20.0, 60.0, 100.0, 400.0, 2000.0)
    sets = [128.0 + size * ring + random.normal(0.0, size / 3, ring.shape) for size in sizes]
    return [points[None].astype(np.float32) for points in sets]
